"""The numbers by which simulation, rest, linear models and sets of plants with effects trade accuracy for time.

Compiled kernels (`robustlab.dynamics.ports`, `robustlab.dynamics.stewart.kernels`) hold their own.
"""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.shown import Tuning


@dataclass(frozen=True)
class DynamicsTuning(Tuning):
    """Each with its meaning, and what a larger one does."""

    # --- clocks and inputs -------------------------------------------------------------------------------------------
    # Steps of a clock that differ by less than this share of their mean are equal. Larger: fewer matrix exponentials,
    # but real jitter is passed over.
    clock_rounding: float = 1e-9
    # A discrete model's clock may jitter by this share of its sample time, and that of a plant with effects by this
    # share of the mean step. Larger: coarser records are taken as uniform.
    clock_jitter: float = 1e-6
    # Slopes of a sampled input that differ by less than this share of the largest are one straight line. Larger: fewer
    # restarts of the integrator, at the price of its order where the input does bend.
    straight: float = 1e-9
    # Local error of a nonlinear simulation where none was asked for.
    rtol: float = 1e-8

    # --- one law at one instant --------------------------------------------------------------------------------------
    # Length of the step in s in which a law is asked; positions move through their value by v times this.
    instant: float = 1e-5
    # The compliance is chosen so that the force changes the velocity by this share: its rounding costs three digits.
    # Larger: fewer digits lost, slower to settle.
    compliance_share: float = 1e-3
    # Forces agree to this share, after so many passes at most.
    force_agreed: float = 1e-13
    force_passes: int = 60
    # Velocity (rad/s, m/s, A) at which "just moving" is looked at; a law that rises faster counts as a jump.
    creep: float = 1e-9
    # First steps of the differences: in position (rad, m), as a share of the velocity, and at rest (rad/s, m/s).
    # Larger: farther from the point, less rounding; extrapolation takes the first two to the limit.
    position_step: float = 1e-4
    velocity_step: float = 1e-2
    rest_step: float = 1e-6
    # Each level of the extrapolation shrinks the step by this; so many levels at most.
    shrink: float = 1.4
    levels: int = 10
    # A displacement (rad, m) at which no bristle or spring gives way, made slowly and quickly (s).
    displacement: float = 1e-12
    slow: float = 1e3
    quick: float = 1e-6

    # --- plants with effects -----------------------------------------------------------------------------------------
    # The laws' steps are laid out for samples of this length in s; longer samples are divided. Larger: quicker, and
    # reversals are located less well.
    nominal_step: float = 1e-3
    # Of a nonlinear plant the steps are halved until the states change by no more than this share of their root mean
    # square, so many times at most. Larger: quicker, less exact.
    halved: float = 1e-4
    most_halvings: int = 5
    # Matrix exponentials and models that a simulator keeps.
    kept: int = 64
    # Sweeps over joints that rest together, and the share of the largest force at which they agree.
    rest_sweeps: int = 200
    rest_agreed: float = 1e-13
    # Newton steps towards rest. Holding forces come before inputs and positions: in the shortest step they weigh
    # ``cheap`` times less. Rest is where a rate is no more than the share ``still`` of the terms that make it up.
    rest_passes: int = 60
    cheap: float = 1e4
    still: float = 1e-11
    # Where parameters change, a Newton step that leads away is halved so often at most.
    rest_halvings: int = 40
    # Share of the signal over which the slope of an input or output map is taken, and the least level for it.
    signal_step: float = 1e-3
    least_level: float = 1e-3

    # --- sets --------------------------------------------------------------------------------------------------------
    # Entries of an exact form that differ by less than this share of their matrix' largest are equal.
    form_rounding: float = 1e-9
    # Amplitudes at which a sector that is the same is taken for one of all amplitudes.
    stretches: tuple[float, ...] = (0.5, 1.0, 2.0)
    # The nominal member of a set must be the plant's own linear model to this share of its largest response.
    nominal_exact: float = 1e-8
    # The simulated states must be those of the linear part under the loads to this share of their size.
    loads_exact: float = 1e-6
    # Points of a sample at which the response to a load is looked at.
    load_points: int = 16
    # Of what the laws at one port leave open, one that position and speed tell takes so much less than the others.
    told_share: float = 1e-3
    # Samples, those of the largest force, at which a law is asked with other values of its parameters.
    told_samples: int = 200

    # --- linear models over the ranges of parameters -----------------------------------------------------------------
    # A parameter is exact where the descriptor form is a polynomial of it over this share of its value to both sides
    # (of a value of 0 over so many half widths). Larger: a function that is none is told from one more surely, but
    # more plants have no linear model that far away.
    family_reach: float = 0.5
    family_zero: float = 30.0
    # Chebyshev nodes along a parameter, the highest degree that is looked for, and the number of highest coefficients
    # that show the rounding. More nodes tell weak functions from polynomials more surely.
    family_nodes: int = 13
    family_degree: int = 3
    family_top: int = 4
    # Products of parameters in a descriptor form at most.
    family_monomials: int = 600
    # Random values at which a form, and then the model, are checked against the plant.
    family_checks: int = 12
    # Sampled parameters: corners of the box at most, and powers of two of inner points. More: a safer cover, slower.
    family_corners: int = 64
    family_sobol: int = 8
    # A higher degree (up to the second number) is taken where more than this share of the effect is left.
    family_share: float = 0.25
    family_cover_degree: int = 3
    # The block for the rest is so much larger than the samples ask for; fresh samples outside it widen it, so often.
    family_room: float = 1.1
    family_rounds: int = 5


TUNING = DynamicsTuning()
