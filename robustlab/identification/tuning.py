"""Numbers of the naming of effects that several modules share; those of one stand there."""

AS_LARGE = 5e-3  # share by which errors differ that are called as large
SHORTEST_WINDOW = 40  # samples
FEWEST_WINDOWS = 4  # of a record that is taken at all
# RMS deviation of a nonlinear plant as given from the recorded motion, over that motion's range, in a window: about
# the motion it is linear, right to the square of this.
MOST_DEVIATION = 0.03
STEP = 2e-3  # of a standardised parameter, for differences
START_STEP = 0.02  # of a window's start, for differences
# Order of the autoregression that makes errors white where they are noise; where something is still missing, whose
# small and fast part that would bring out, it is the first.
AR_ORDER = 3
BEYOND_NOISE = 60.0  # times the sensors' noise: something is missing. A quiet machine's torque noise: < 25
# Iterations of the fit of the model as given, which must be at its optimum, or whatever is added would seem to gain
# what it still had to gain itself; of a set from which one effect was taken; of a full fit.
BASE = 25
LAST = 8
FULL = 15
LEAST_STEPS = 1  # a sample
SURE = 0.95  # probability of a set from which it is named, and of the sets in an answer together
CANNOT_TELL = 3.0  # refit distance in noise sigmas below which no test on these records tells two effects
FAR_BEHIND = 40.0  # log evidence beyond which the distance is not worth its time
MOST_NOISE = 1.5  # error over noise and random force, beyond which something systematic is missing
MOST_RANDOM = 0.05  # of the force that moves a port: a random force beyond is no noise of a machine
# Share of the error it leaves by which the error without a name is larger, or of the force that moves its joint.
MATERIAL = 0.05
