"""Constants that several modules of this package share."""

from __future__ import annotations

# A discrete model's clock may jitter by this share of its sample time, and that of a plant with effects by this
# share of the mean step. Larger: coarser records are taken as uniform.
CLOCK_JITTER = 1e-6
# Local error of a nonlinear simulation where none was asked for.
RTOL = 1e-8
# First steps of the differences: in position (rad, m), as a share of the velocity, and at rest (rad/s, m/s).
# Larger: farther from the point, less rounding; extrapolation takes the first two to the limit.
POSITION_STEP = 1e-4
# The laws' steps are laid out for samples of this length in s; longer samples are divided. Larger: quicker, and
# reversals are located less well.
NOMINAL_STEP = 1e-3
# Newton steps towards rest. Holding forces come before inputs and positions: in the shortest step they weigh
# ``cheap`` times less. Rest is where a rate is no more than the share ``still`` of the terms that make it up.
REST_PASSES = 60
STILL = 1e-11
