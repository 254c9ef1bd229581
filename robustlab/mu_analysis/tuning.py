"""Numbers that choose how long bounds of mu take and how close they come, in one place."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.budget import MILLION
from robustlab.shown import Tuning


@dataclass(frozen=True)
class MuTuning(Tuning):
    """Tuning of this wing; no number here decides whether a bound holds, but those that say when a Delta attains one.

    Work is counted in units of about a microsecond (`robustlab.budget`), shares are of it.
    """

    work: float = 60 * MILLION  # the usual work of a proof at effort 1
    # --- upper bounds: D and G (upper, interior_point, certificate) ---
    ratios: tuple[float, ...] = (2.0**-10, 2.0**-20, 2.0**-40, 2.0**-80)
    # of D between one component and the next, tried in turn; smaller: their coupling costs less, digits are lost
    start: float = 1.3  # t at which a path begins, for M of norm 1: D = I, G = 0 is feasible there
    rho: float = 0.3  # weight of the barrier that keeps D away from singular; larger: safer, farther from the optimum
    near: float = 0.3  # squared Newton decrement below which a point counts as centred; smaller: more steps, safer ones
    step: float = 0.9  # part of the way to the boundary that a predictor step goes; larger: fewer steps, less centred
    negative: float = -1.0  # t below this, of a matrix of norm 1, cannot make a proof of mu = 0 any firmer
    # --- lower bounds (lower, minimum_norm, starting_points) ---
    singular: float = 1e-11  # relative smallest singular value below which I - M Delta counts as singular
    # Share of the norm of a Delta that attains its bound, within which an exactly singular one is seen to first order;
    # near a double root that is half of the way.
    nearby: float = 5e-9
    chosen: int = 6  # candidates per matrix that are taken to rounding and verified
    wider: int = 3  # so many times the paths asked for begin where blocks are real; the most promising go on
    descending: int = 2  # candidates per matrix that go down along the singular set ...
    rounds: int = 12  # ... in so many rounds
    few: int = 5  # structures of so few real blocks alone get scattered starts as well ...
    scattered: int = 48  # ... so many
    farthest: float = 2.0**500  # to which rows and columns are scaled; two such factors must not overflow
    stack: int = 4_000_000  # numbers that one stack of paths may hold: memory, not the answer
    free: int = 6  # undamped steps at the beginning of a path; more: faster where few blocks lie inside, or cycles
    restoring: int = 5  # steps at its end that restore singularity
    path_residual: float = 1e-7  # below which a Delta of a path is kept; it is taken to rounding later
    least_room: float = 0.02  # share of the norm by which every real block may move where singularity is restored
    least_descent: float = 1e-4  # relative fall of the norm that descent goes on for
    huge: float = 1e9  # entries of Delta beyond this lead nowhere; M is of order one
    sweeps: int = 2  # of coordinate ascent over the real blocks
    exhaustive: int = 7  # vertices of so many real parameters are all tried; one more doubles them
    # --- gain and skewed mu (gain, skew) ---
    ascents: int = 40  # steps of an ascent
    rise: float = 1e-7  # an ascent ends where a step gains less than this share
    skew_rounds: int = 14  # levels of skewed mu one after the other
    inflations: tuple[float, ...] = (0.0, *(10.0**-k for k in range(13, 2, -1)))
    # by which a level is raised until its D, G prove it
    largest_level: float = 1e8  # above it, for M of norm one, the fixed blocks alone count as at the edge of singular
    # --- branch and bound (branch_and_bound, axis_problems) ---
    first_branches: float = 0.02  # share of the work for it before a smaller Delta is sought by modes
    regions: int = 16  # solved together; more: quicker each, more of them in vain where a Delta is met
    searched: int = 2  # regions of a batch in which a Delta is searched for, where the problem is one matrix
    kept: float = 0.0625  # share of the work kept for a smaller set, and spent before a set is judged out of reach
    narrow: float = 1e-7  # relative width below which a box is not cut again: rounding decides there
    inside: float = 0.98  # level aimed at in a region; smaller: wider intervals, more cuts
    proved: float = 0.9999  # a level below this proves the point
    misses: int = 3  # frequencies in a row that cannot be proved cut a region; more: less is proved twice, more in vain
    near_miss: float = 0.01  # log width around a missed frequency in which no other is tried before the cut
    # --- intervals of the axis (intervals, stability, worst_gain) ---
    slack: float = 1e-5  # the Hamiltonian is that of a beta smaller by this: a blurred double root costs far less
    frequencies: int = 8  # at which D, G are sought together
    creeping: float = 0.97  # share of what is open that a round may leave open before the level is raised
    probes: int = 12  # frequencies at which a sign is tested to find an end, or what the eigenvalues have missed
    coarse: float = 4e-3  # accuracy of the first cover, which tells whether branch and bound has to follow
    sharpened: tuple[float, float, float] = (0.1, 5.0, 8e-4)
    # half width, in log frequency, of the first neighbourhood in which a smaller complex Delta is sought, the factor by
    # which the next are smaller, and the last one in shares of the distance of the nearest pole
    sizes: int = 12  # of an asymmetric set, tried for the largest one that D, G prove ...
    large: float = 1e3  # ... the first of them where nothing is known
    members: int = 6  # of the set that are followed to a peak of their own
    skewed: int = 4  # bounds of mu that one skewed bound costs: counts work only
    # --- poles led to the axis (pole_migration) ---
    leading: int = 15  # steps that lead a pole to the axis; more: smaller ones
    following: int = 30  # steps along the axis
    scaling: int = 6  # steps at the end that change the size of Delta alone
    crossings: int = 8  # candidates that are taken to the axis exactly
    peaks: int = 6  # of mu on the grid that paths start from
    axis_rounds: int = 15  # of descent along the axis at most ...
    least_axis_descent: float = 1e-5  # ... each of which has to lower the norm by this share
    # --- modes driven to the axis inside a box (mode_ascent) ---
    ascent_least: float = 0.25  # the smallest box looked into, in sizes of the smallest member known at first ...
    ascent_reach: float = 0.99  # ... and of the largest one
    ascents_in_vain: int = 5  # as many ascents there, for each mode, without anything smaller end a chain of them ...
    ascent_chains: int = 3  # ... and so many chains in a row the search
    ascent_members: int = 100  # of the box, looked at for starts ...
    ascent_modes: int = 5  # ... of so many least damped modes, and as many others; twice as many go on from their best
    ascent_thrown: int = 3  # so many parameters at most are thrown anew for that
    ascent_first: float = 0.3  # share of the way to its own corner at which a nominal mode begins
    ascent_step: float = 0.05  # share by which the box shrinks around a mode that was led across the axis ...
    ascent_last_step: float = 0.01  # ... and at the end
    ascents_of_mode: int = 30  # quasi-Newton steps of one ascent
    ascent_halvings: int = 20  # of the way from the nominal model to an unstable member
    ascent_share: float = 0.25  # of the work left, for all of it
    # --- disk margins, small gain, covers ---
    disk_close: float = 1e-5  # bounds of several loops that are farther apart get a closer search along the axis
    disk_singular: float = 1e-7  # relative smallest singular value of a loop that a critical disk closes
    at_end: float = 1e-12  # the same at an end of the axis, where a pole runs off to infinity
    norm_width: float = 1e-9  # relative width of the bracket of the small-gain test's norm
    alone: float = 0.2  # share of the work for the question whether a member is unstable without any disk
    margin_accuracy: float = 2e-4  # of the scaled set's margin: it changes less than the size of the disks does
    on_the_axis: float = 1e-9  # a pole this close to the stability boundary, beside the fastest, is not stable
    margins: int = 25  # after which a search ends whose bounds no longer move
    exact: float = 1e-12  # what rounding may take from a member of a cover that is met exactly


TUNING = MuTuning()
