"""The numbers that the naming of effects is tuned by, from the windows of a record to the next experiment.

They choose how long a search goes on, how finely it looks, and how much evidence a name needs. They hold for machines
of any size: shares, counts, multiples of noise, and logarithms of likelihoods. Statistical facts (the 95 % of an
interval) and rounding are no tuning and stay where they are used.
"""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.shown import Tuning

AS_LARGE = 5e-3  # share by which errors differ that are called as large


@dataclass(frozen=True)
class NamingTuning(Tuning):
    """Numbers that choose speed and accuracy of `robustlab.discover`."""

    # --- windows
    windows_wanted: int = 12  # in the shortest record: more and shorter ones drift less and tell slow effects worse
    shortest_window: int = 40  # samples
    longest_window: int = 480  # samples; the slowest time constant may ask for up to twice that
    fewest_windows: int = 4  # of a record that is taken at all
    points_per_window: int = 80  # into which errors are averaged: more show faster effects and take more time
    longest_guess: int = 2  # samples in a row without any output over which the input is taken as held
    averaged_share: float = 0.125  # of the period of the fastest motion seen: errors are averaged over no more
    # Of the current that voltage and speed ask for: how well one is known that no sensor tells; with the inflation
    # below a fit may move it by 0.3 of that at a window's start.
    current_share: float = 0.01
    # Times the smoother's own std by which a fit may move a window's start. The smoother has seen the window itself, so
    # its start is told by the fit and not by it.
    start_inflation: float = 30.0
    most_growth: float = 20.0  # of what an unstable nonlinear plant deviates by, over a window
    # RMS deviation of a nonlinear plant as given from the recorded motion, over that motion's range, in a window: about
    # the motion it is linear, right to the square of this.
    most_deviation: float = 0.03
    most_windows: int = 24  # that the search fits: more tell weaker effects and take more time
    most_samples: int = 2400  # of a nonlinear plant, in the windows that the search fits
    most_held: int = 12  # that it judges on
    held_out_every: int = 4  # without a held-out record, every so manieth window is kept from the fit

    # --- candidates
    spatial_lines: int = 3  # tried of a force over the position: more find weaker ripples, each costs fits
    finest_lines: int = 1500  # per range of the position: finer ripples are not looked for
    line_p: float = 0.01  # probability by which a line of a force over time may be noise

    # --- the fit of one hypothesis
    step: float = 2e-3  # of a standardised parameter, for differences
    start_step: float = 0.02  # of a window's start, for differences
    farthest: float = 8.0  # standardised parameters are kept within this of their priors
    relative: float = 1e-5  # fall of V, over V, below which a fit stops: smaller, more iterations in flat valleys
    # Of the diagonal. A stretched resistance and inertia leave nearly the same errors: along such a valley J^T J is a
    # millionth of its diagonal, and a damping above that creeps.
    damping: float = 1e-4
    least_damping: float = 1e-10
    bend: float = 0.1  # of a step, at which its curvature is measured
    most_bent: float = 0.75  # share of a step that its correction may be: larger follows sharper valleys
    tries: int = 8  # damped steps before a fit gives up
    hope: float = 2.0  # times the expected fall of V that a fit may still fall by: smaller gives up sooner
    longest_step: float = 2.0  # of a standardised parameter in one step

    # Standard deviations of a parameter by which a fit may go on with the matrices of a nonlinear plant: they multiply
    # what deviates from the motion alone, and are made anew where the fit ends.
    near: float = 0.5

    # --- looks at single effects, rough and then fuller
    workers: int = 2
    # Order of the autoregression that makes errors white where they are noise; where something is still missing, whose
    # small and fast part that would bring out, it is the first.
    ar_order: int = 3
    beyond_noise: float = 60.0  # times the sensors' noise: something is missing. A quiet machine's torque noise: < 25
    # Iterations of the base and of each round. The base must be at its optimum, or whatever is added would seem to gain
    # what it still had to gain itself.
    base: int = 25
    first: int = 4
    second: int = 6
    last: int = 8
    rough: float = 0.5  # fall of V at which the first two rounds stop
    first_windows: int = 12  # that the first round looks at, and the second: more judge better and take more time
    second_windows: int = 18
    most_scored: int = 30  # effects of a nonlinear plant that enter the first round: more find what no score shows
    kept_second: int = 10  # hypotheses that enter the second round, and the last
    kept_last: int = 8
    kept_gains: int = 2  # wrong gains beside them: at the same cost the prior may prefer one
    full: int = 15  # iterations of a full fit
    rough_fits: int = 4  # full fits before the noise is known, of fewer iterations: they only have to find a leader
    rough_full: int = 6
    promising: float = 3.0  # log-likelihood that a candidate must have gained in the first round to be pursued
    most_stretched: float = 0.5  # log factor; friction coefficients stretch further and say nothing of a gain

    # --- clocks
    clock_share: float = 0.25  # of a sample: standard deviation of an input's shift
    least_steps: int = 1  # a sample
    most_steps: int = 4  # a sample: more follow stiffer contacts and take more time
    step_error: float = 0.1  # of the noise, by which half as long steps may change a residual

    # --- the sets of effects
    most_effects: int = 4
    beginnings: int = 3  # single effects from which sets are built where something is missing
    in_one_piece: float = 3.0  # scatter of the windows, over that of independent errors, from which something is
    most_expansions: int = 12  # sets to which effects are added before the search is called unfinished
    most_work: int = 240_000_000  # steps of simulation, after which no further set is expanded
    prior_effect: float = 0.02  # of an effect at a place
    prior_refinement: float = 0.1  # of a refinement, over that of the effect it refines
    looked_elsewhere: float = 200.0  # periods among which the one of a ripple was found
    temperature: float = 1.0  # by which log evidence is divided at least: above 1, less sure
    sure: float = 0.95  # probability of a set from which it is named, and of the sets in an answer together
    settling: int = 15  # iterations of the reported fits

    # --- rivals
    cannot_tell: float = 3.0  # refit distance in noise sigmas below which no test on these records tells two effects
    most_places: int = 2  # at which an unnamed force is looked for
    most_weighed: int = 5  # sets that are weighed again under a random force
    most_rivals: int = 5  # looked at for each named effect
    out_of_sight: float = 100.0  # times the V that would come near a set that leaves only noise, after two looks
    far_behind: float = 40.0  # log evidence beyond which the distance is not worth its time

    # --- verdict
    mostly: float = 0.5  # of what the bare model lacks, by names that are sure beside a misfit; below, they are not it
    explained: float = 0.9  # of what the bare model lacks; below, what was named is not the effect
    most_noise: float = 1.5  # error over noise and random force, beyond which something systematic is missing
    most_random: float = 0.05  # of the force that moves a port: a random force beyond is no noise of a machine
    repeatable: float = 1.6  # F of the residual against the noise floor beyond which something repeatable remains

    # --- what matters
    # Share of the error it leaves by which the error without a name is larger, or of the force that moves its joint.
    material: float = 0.05
    remark: float = 0.005  # of the force that moves the port: a weaker line that remains is a remark

    # --- what remains
    residual_blocks: int = 32  # of time, over all records
    residual_samples: int = 6000  # over all records; the force is smooth, so every so manieth sample tells it
    line_alarm: float = 0.01  # p-value of a line worth telling
    most_lines: int = 4
    line_worth: float = 0.02  # of the mean square of the force: a weaker line is certain and of no use
    fewest_turns: float = 8.0  # over the range of the position: fewer are a curve, which the splines have taken
    turns_per_block: float = 3.0  # of a line over time: slower ones cannot be told from drift between blocks
    most_waves: int = 3000  # wave numbers tried over a coordinate
    oversampling: float = 2.0  # wave numbers tried per turn over the range
    waves_at_once: int = 300  # bounds the memory
    finer_waves: int = 41  # of the last search, between the neighbours of the best one
    curve_stiffness: float = 1e-4  # of the smooth curves that are taken off first

    # --- the next experiment
    most_opponents: int = 3  # rivals that it is to tell from the named effect
    longest_experiment: int = 5000  # samples
    time_constants_seen: float = 20.0  # slowest time constants of the plant in an experiment, at least
    time_constants_a_beat: float = 8.0  # the same in a beat of the signals
    most_beats: int = 16  # in an experiment
    fewest_beats: int = 4
    shorter_beats: tuple[float, ...] = (1.0, 0.5, 0.25, 0.125)  # tried where the plant would run out of its travel
    refitted_entries: int = 5  # of the menu, properly: more find better experiments, each costs fits of all pairs
    refit_iterations: int = 12  # valleys of two parameters that nearly do the same are long
    assumed_noise: float = 1e-3  # of the range, of a sensor that was not recorded so far
    sensor_worth: float = 0.25  # share of d that a new sensor must bring


TUNING = NamingTuning()
