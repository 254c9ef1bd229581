"""Constants that several modules of effect identification share."""

AS_LARGE = 5e-3  # relative difference below which two errors count as equal
SHORTEST_WINDOW = 40  # samples
FEWEST_WINDOWS = 4  # in a usable record
# RMS deviation of the nominal nonlinear plant from the recorded motion in a window, over that motion's range: the
# relative error of the linearisation is its square.
MOST_DEVIATION = 0.03
STEP = 2e-3  # finite difference of a standardised parameter
START_STEP = 0.02  # finite difference of a window's initial state
# Order of the autoregression that whitens errors; 1 while an effect is missing: more would amplify its fast part.
AR_ORDER = 3
BEYOND_NOISE = 60.0  # times the sensor noise: an effect is missing. Torque noise of a quiet machine: < 25
# Iterations of the nominal fit (before its optimum, any addition seems to help), after removing an effect, and in full.
BASE = 25
LAST = 8
FULL = 15
LEAST_STEPS = 1  # per sample
SURE = 0.95  # probability at which a set is named, and total probability of the sets in an answer
INTERVAL = 1.96  # standard deviations of a 95 % interval
CANNOT_TELL = 3.0  # refit distance in noise sigmas below which these records cannot distinguish two effects
FAR_BEHIND = 40.0  # log evidence beyond which no refit distance is computed
MOST_NOISE = 1.5  # error over noise and random force, beyond which a systematic error remains
MOST_RANDOM = 0.05  # random force over the force that moves the port: a machine's noise is smaller
MATERIAL = 0.05  # relative rise of the error without the effect, or share of its joint's force, that is relevant
