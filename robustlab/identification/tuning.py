"""The numbers that the naming of effects is tuned by, from the windows of a record to the next experiment.

They choose how long a search goes on, how finely it looks, and how much evidence a name needs. They hold for machines
of any size: shares, counts, multiples of noise, and logarithms of likelihoods. Statistical facts (the 95 % of an
interval) and rounding are no tuning and stay where they are used.
"""

AS_LARGE = 5e-3  # share by which errors differ that are called as large

# --- windows
WINDOWS_WANTED = 12  # in the shortest record: more and shorter ones drift less and tell slow effects worse
SHORTEST_WINDOW = 40  # samples
LONGEST_WINDOW = 480  # samples; the slowest time constant may ask for up to twice that
FEWEST_WINDOWS = 4  # of a record that is taken at all
POINTS_PER_WINDOW = 80  # into which errors are averaged: more show faster effects and take more time
LONGEST_GUESS = 2  # samples in a row without any output over which the input is taken as held
AVERAGED_SHARE = 0.125  # of the period of the fastest motion seen: errors are averaged over no more
# Of the current that voltage and speed ask for: how well one is known that no sensor tells; with the inflation
# below a fit may move it by 0.3 of that at a window's start.
CURRENT_SHARE = 0.01
# Times the smoother's own std by which a fit may move a window's start. The smoother has seen the window itself, so
# its start is told by the fit and not by it.
START_INFLATION = 30.0
MOST_GROWTH = 20.0  # of what an unstable nonlinear plant deviates by, over a window
# RMS deviation of a nonlinear plant as given from the recorded motion, over that motion's range, in a window: about
# the motion it is linear, right to the square of this.
MOST_DEVIATION = 0.03
MOST_WINDOWS = 24  # that the search fits: more tell weaker effects and take more time
MOST_SAMPLES = 2400  # of a nonlinear plant, in the windows that the search fits
MOST_HELD = 12  # that it judges on
HELD_OUT_EVERY = 4  # without a held-out record, every so manieth window is kept from the fit

# --- candidates
SPATIAL_LINES = 3  # tried of a force over the position: more find weaker ripples, each costs fits
FINEST_LINES = 1500  # per range of the position: finer ripples are not looked for
LINE_P = 0.01  # probability by which a line of a force over time may be noise

# --- the fit of one hypothesis
STEP = 2e-3  # of a standardised parameter, for differences
START_STEP = 0.02  # of a window's start, for differences
FARTHEST = 8.0  # standardised parameters are kept within this of their priors
RELATIVE = 1e-5  # fall of V, over V, below which a fit stops: smaller, more iterations in flat valleys
# Of the diagonal. A stretched resistance and inertia leave nearly the same errors: along such a valley J^T J is a
# millionth of its diagonal, and a damping above that creeps.
DAMPING = 1e-4
LEAST_DAMPING = 1e-10
BEND = 0.1  # of a step, at which its curvature is measured
MOST_BENT = 0.75  # share of a step that its correction may be: larger follows sharper valleys
TRIES = 8  # damped steps before a fit gives up
HOPE = 2.0  # times the expected fall of V that a fit may still fall by: smaller gives up sooner
LONGEST_STEP = 2.0  # of a standardised parameter in one step

# Standard deviations of a parameter by which a fit may go on with the matrices of a nonlinear plant: they multiply
# what deviates from the motion alone, and are made anew where the fit ends.
NEAR = 0.5

# --- looks at single effects, rough and then fuller
WORKERS = 2
# Order of the autoregression that makes errors white where they are noise; where something is still missing, whose
# small and fast part that would bring out, it is the first.
AR_ORDER = 3
BEYOND_NOISE = 60.0  # times the sensors' noise: something is missing. A quiet machine's torque noise: < 25
# Iterations of the base and of each round. The base must be at its optimum, or whatever is added would seem to gain
# what it still had to gain itself.
BASE = 25
FIRST = 4
SECOND = 6
LAST = 8
ROUGH = 0.5  # fall of V at which the first two rounds stop
FIRST_WINDOWS = 12  # that the first round looks at, and the second: more judge better and take more time
SECOND_WINDOWS = 18
MOST_SCORED = 30  # effects of a nonlinear plant that enter the first round: more find what no score shows
KEPT_SECOND = 10  # hypotheses that enter the second round, and the last
KEPT_LAST = 8
KEPT_GAINS = 2  # wrong gains beside them: at the same cost the prior may prefer one
FULL = 15  # iterations of a full fit
ROUGH_FITS = 4  # full fits before the noise is known, of fewer iterations: they only have to find a leader
ROUGH_FULL = 6
PROMISING = 3.0  # log-likelihood that a candidate must have gained in the first round to be pursued
MOST_STRETCHED = 0.5  # log factor; friction coefficients stretch further and say nothing of a gain

# --- clocks
CLOCK_SHARE = 0.25  # of a sample: standard deviation of an input's shift
LEAST_STEPS = 1  # a sample
MOST_STEPS = 4  # a sample: more follow stiffer contacts and take more time
STEP_ERROR = 0.1  # of the noise, by which half as long steps may change a residual

# --- the sets of effects
MOST_EFFECTS = 4
BEGINNINGS = 3  # single effects from which sets are built where something is missing
IN_ONE_PIECE = 3.0  # scatter of the windows, over that of independent errors, from which something is
MOST_EXPANSIONS = 12  # sets to which effects are added before the search is called unfinished
MOST_WORK = 240_000_000  # steps of simulation, after which no further set is expanded
PRIOR_EFFECT = 0.02  # of an effect at a place
PRIOR_REFINEMENT = 0.1  # of a refinement, over that of the effect it refines
LOOKED_ELSEWHERE = 200.0  # periods among which the one of a ripple was found
TEMPERATURE = 1.0  # by which log evidence is divided at least: above 1, less sure
SURE = 0.95  # probability of a set from which it is named, and of the sets in an answer together
SETTLING = 15  # iterations of the reported fits

# --- rivals
CANNOT_TELL = 3.0  # refit distance in noise sigmas below which no test on these records tells two effects
MOST_PLACES = 2  # at which an unnamed force is looked for
MOST_WEIGHED = 5  # sets that are weighed again under a random force
MOST_RIVALS = 5  # looked at for each named effect
OUT_OF_SIGHT = 100.0  # times the V that would come near a set that leaves only noise, after two looks
FAR_BEHIND = 40.0  # log evidence beyond which the distance is not worth its time

# --- verdict
MOSTLY = 0.5  # of what the bare model lacks, by names that are sure beside a misfit; below, they are not it
EXPLAINED = 0.9  # of what the bare model lacks; below, what was named is not the effect
MOST_NOISE = 1.5  # error over noise and random force, beyond which something systematic is missing
MOST_RANDOM = 0.05  # of the force that moves a port: a random force beyond is no noise of a machine
REPEATABLE = 1.6  # F of the residual against the noise floor beyond which something repeatable remains

# --- what matters
# Share of the error it leaves by which the error without a name is larger, or of the force that moves its joint.
MATERIAL = 0.05
REMARK = 0.005  # of the force that moves the port: a weaker line that remains is a remark

# --- what remains
RESIDUAL_BLOCKS = 32  # of time, over all records
RESIDUAL_SAMPLES = 6000  # over all records; the force is smooth, so every so manieth sample tells it
LINE_ALARM = 0.01  # p-value of a line worth telling
MOST_LINES = 4
LINE_WORTH = 0.02  # of the mean square of the force: a weaker line is certain and of no use
FEWEST_TURNS = 8.0  # over the range of the position: fewer are a curve, which the splines have taken
TURNS_PER_BLOCK = 3.0  # of a line over time: slower ones cannot be told from drift between blocks
MOST_WAVES = 3000  # wave numbers tried over a coordinate
OVERSAMPLING = 2.0  # wave numbers tried per turn over the range
WAVES_AT_ONCE = 300  # bounds the memory
FINER_WAVES = 41  # of the last search, between the neighbours of the best one
CURVE_STIFFNESS = 1e-4  # of the smooth curves that are taken off first

# --- the next experiment
MOST_OPPONENTS = 3  # rivals that it is to tell from the named effect
LONGEST_EXPERIMENT = 5000  # samples
TIME_CONSTANTS_SEEN = 20.0  # slowest time constants of the plant in an experiment, at least
TIME_CONSTANTS_A_BEAT = 8.0  # the same in a beat of the signals
MOST_BEATS = 16  # in an experiment
FEWEST_BEATS = 4
SHORTER_BEATS = (1.0, 0.5, 0.25, 0.125)  # tried where the plant would run out of its travel
REFITTED_ENTRIES = 5  # of the menu, properly: more find better experiments, each costs fits of all pairs
REFIT_ITERATIONS = 12  # valleys of two parameters that nearly do the same are long
ASSUMED_NOISE = 1e-3  # of the range, of a sensor that was not recorded so far
SENSOR_WORTH = 0.25  # share of d that a new sensor must bring
