"""Numbers that choose between speed and accuracy in the design methods: one class for each room, defaults as measured.

None of them is a matter of truth: what is returned is proved on the loop rebuilt from the controller. Functions read
them from an instance that is handed down from the entry of their room, so that a benchmark can vary one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from robustlab.budget import MILLION

__all__ = [
    "FIXED",
    "H2",
    "HINF",
    "NONSMOOTH",
    "PROBLEM",
    "FixedTuning",
    "H2Tuning",
    "HinfTuning",
    "NonsmoothTuning",
    "ProblemTuning",
]


@dataclass(frozen=True)
class ProblemTuning:
    """Checks of a finished loop, and bounds of what any loop can do."""

    # --- the second voice: P and K evaluated separately
    # A value whose error bound exceeds this share of the largest gain (of its own size; of the polynomial) is computed
    # once more with 30 digits. Smaller: more of them, slower.
    quick: float = 1e-6
    quick_everywhere: float = 1e-5
    quick_rouche: float = 2e-2
    # Frequencies per decade between the poles, and most of them.
    per_decade: int = 5
    most_points: int = 120
    # Zooms into the highest local maxima: how often, how many maxima, points in each, least height of one.
    zooms: int = 2
    zoom_peaks: int = 3
    zoom_points: int = 7
    peak_share: float = 0.9
    # Frequencies that hit a pole move by this share of the distance to the loop's poles, which T cannot feel.
    aside: float = 1e-6
    # Work with many digits that one check may do, in points times states cubed.
    careful_work: float = 2e6
    # Numbers of a stack that is kept in memory.
    chunk: int = 4_000_000

    # --- the H2 norm by quadrature
    # How far it goes beyond the slowest and the fastest pole.
    beyond: float = 1e4
    # From so many states of the loop on the rebuilt loop's response is compared in its place.
    many_states: int = 30
    # Points of a panel, rounds of bisection, change of a panel (share of the whole) that ends it, most points.
    nodes: int = 8
    rounds: int = 30
    panel_change: float = 1e-6
    most_nodes: int = 20_000

    # --- lower bounds of gamma
    # Points of the right half plane: radii and angles of a polar grid. More: a little higher bounds.
    radii: int = 48
    angles: tuple[float, ...] = (0.0, 0.5, 1.0, 1.35, 1.5, math.pi / 2)
    # Refinements around the best points, how many of them, and points that every scaling has to confirm.
    refinements: int = 4
    refined: int = 3
    confirmed: int = 12

    # --- measures of loops
    # Points of the grid on which candidates are compared before one of them is proved.
    measure_grid: int = 60
    # Most work of the proof of one candidate without scalings.
    margin_work: float = 30 * MILLION


PROBLEM = ProblemTuning()


@dataclass(frozen=True)
class HinfTuning:
    """H-infinity designs; lengths of tuples are numbers of trials, "scaled" means a plant scaled to order one."""

    # Work of a design at effort 1; few plants need a tenth. More: longer searches on hard plants.
    work: float = 60 * MILLION
    # What a certified norm may cost where the best loop is so stiff that its norm loses digits. Larger: calmer loops.
    calmer: float = 1.001

    # --- trials: regularisations of fixed size, then relative to the best loop
    # Sizes of added penalties and noises, scaled. Longer: singular plants get closer to their infimum.
    ladder: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
    # A central controller at gamma itself is ill-conditioned: gamma is backed off until the gain of the loop agrees.
    # Coarse while gamma falls fast, fine where it counts. Smaller: less is lost, more controllers are numerically void.
    coarse_backoffs: tuple[float, ...] = (1e-2, 0.1)
    fine_backoffs: tuple[float, ...] = (1e-4, 1e-3, 1e-2, 3e-2, 0.1)
    # Shares of the loop's gain that the self-scaled regularisation may cost; the optimum rises by their squares.
    shares: tuple[float, ...] = (0.2, 0.1, 0.05, 0.02, 0.01)
    # Most trials of that kind. More: slower, and a little lower on plants that keep falling.
    self_scaled_steps: int = 14
    # Relative gain of a trial that counts as one. Smaller: more trials for less.
    improvement: float = 5e-4
    # A gamma this near (relative) to a proved bound ends the search. Larger: sooner.
    proved: float = 3e-4
    # Singular values of D12 or D21, scaled, above which that side needs no help. Smaller: digits are lost.
    regular: float = 1e-6
    # Scaled gains below it are zero for every purpose.
    negligible: float = 1e-7
    # Relative difference of two scalings above which both are searched once more with care. Smaller: more often.
    disagreement: float = 5e-4

    # --- the gamma test
    # An exact X = 0 comes out as noise of this size, scaled; it must not count as indefinite. Larger: false passes.
    semidefinite: float = 1e-6
    # Largest residual of a Riccati solution: the loop is verified afterwards, so a poor one only costs a try.
    residual: float = 1e-3
    # Range of gamma that is searched, scaled.
    smallest_gamma: float = 1e-9
    largest_gamma: float = 1e9
    # Shares of the smallest gamma found that are tried once more (the first one; with care all of them): the test in
    # floating point is not monotone in gamma. Longer: fewer false ends, more tests.
    probes: tuple[float, ...] = (0.93, 0.8, 0.6, 0.4, 0.2, 0.07, 0.02)

    # --- the gain of a trial's loop
    # Relative accuracy, and most steps towards it. Finer: better ranking, slower trials.
    gain_accuracy: float = 1e-5
    gain_levels: int = 12
    # Frequencies per decade of the first look, and most of them.
    grid_per_decade: int = 4
    largest_grid: int = 60

    # --- softer controllers near the smallest gamma
    # Rounds of bisection that follow the loop found last; steps in the first and in the later ones. More: slower poles.
    soften_rounds: int = 3
    soften_steps: int = 5
    soften_later_steps: int = 3
    # Share of the loop's gain from which the second softening starts.
    soften_share: float = 0.05

    # --- verification
    # Candidates that are verified before the search counts as failed, and where no norm of them is sure.
    tries: int = 8
    most_tries: int = 40
    # Verified over searched gamma above which the next candidate is tried, too. Larger: quicker, a little worse.
    loss: float = 1.0005
    # A rebuilt loop whose norm is farther (relative) from that of its plant and controller is built in other states.
    drift: float = 1e-5
    # Difference (relative) of the two voices up to which an uncertified norm is credible.
    credible: float = 0.05
    # How much more a certified norm may be than a credible one. Larger: worse gammas for the sake of certificates.
    certificate_worth: float = 2.0

    # --- linear matrix inequalities
    # The programs have n (n + 1) unknowns: beyond this many states they outlast any patience.
    lmi_states: int = 30
    # Steps of the solver: three times what it ever needed.
    lmi_steps: int = 200
    # Back-offs from the optimum, and couplings t of [R tI; tI S] >= 0. Larger: better conditioned, worse gamma.
    lmi_backoffs: tuple[float, ...] = (0.002, 0.02, 0.1)
    lmi_couplings: tuple[float, ...] = (1.5, 1.05)

    # --- nonsmooth descent from what was found
    # A gamma this far above the estimated optimum (or proved bound) is worth a descent. Smaller: more descents.
    poor: float = 1.02
    # Scaled gains below it mean an infimum of zero, where ratios mean nothing.
    near_zero: float = 1e-4
    # Share of the work left for a descent, and most of it: beyond that they creep.
    descent_share: float = 0.25
    descent_work: float = 15 * MILLION
    # Weights of its barrier: larger ones than for a controller that is known to be good look further around.
    descent_barrier: tuple[float, ...] = (3.0, 1.0, 0.3, 0.1, 0.03)
    # Random starts for each order where nothing stabilises yet.
    stabilising_starts: int = 3

    # --- loop shaping
    # How much the verified gamma may exceed the one asked for before digits count as lost.
    shaped_loss: float = 1.001


HINF = HinfTuning()


@dataclass(frozen=True)
class H2Tuning:
    """H2 designs, and H2 designs under an H-infinity bound."""

    # Work of a design at effort 1.
    work: float = 60 * MILLION
    # Sizes of added penalties and noises, scaled. Longer: singular plants get closer to their infimum, K faster.
    ladder: tuple[float, ...] = (1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
    # Singular values of D12 or D21, scaled, above which that side needs no help. Smaller: digits are lost.
    regular: float = 1e-6
    # The regularised optimum falls with the regularisation; two steps that gain less than this end the ladder.
    settled: float = 1e-4
    # Controllers, best first, that the second voice is asked about. More: fewer unconfirmed results, slower.
    heard: int = 6
    # Largest residual of a Riccati solution: those of singular plants lose digits; the rebuilt loop decides.
    residual: float = 1e-3

    # --- under an H-infinity bound
    # Loss of the H2 designs where they have to be kept finite.
    kept_finite: float = 1.0005
    # Levels of the H-infinity inequality in shares of the bound: above 1, because the common Lyapunov matrix makes it
    # conservative; below 1, because the solver may miss its level by a little. Longer: wider searches.
    levels: tuple[float, ...] = (1.0, 1.3, 1.7, 2.5, 4.0, 8.0)
    lower_levels: tuple[float, ...] = (0.995, 0.97, 0.9)
    # Steps of bisection between two levels. More: closer to the bound.
    refinements: int = 5
    # Factors by which the split of the level between w and z is moved, as long as the H2 norm falls by this much.
    split_factors: tuple[float, ...] = (3.0, 1 / 3)
    split_gain: float = 0.01
    # The bound over the smallest H-infinity norm from which on a softer design is looked for, too.
    room: float = 1.02
    # Powers of the fourth root of ten, first and last, of the H-infinity channel's weight in H2 designs.
    weight_steps: tuple[int, int] = (-4, 12)
    # Most steps of the conic solver, and the weight on the size of X and Y, which keeps K finite where the infimum is
    # not attained. A larger one: calmer controllers, a larger norm.
    lyapunov_steps: int = 200
    lyapunov_size: float = 1e-7


H2 = H2Tuning()


@dataclass(frozen=True)
class NonsmoothTuning:
    """Nonsmooth optimisation of loops; "scaled" means in variables without units, of order one."""

    # --- BFGS
    # Weak Wolfe conditions: share of the predicted decrease that is enough, and of the slope that must have risen.
    decrease: float = 1e-4
    curvature: float = 0.5
    # Most trials of a line search.
    line_steps: int = 25
    # Steps of next to no decrease in a row that end a descent. More: slower ends, rarely a little lower.
    stall_steps: int = 8

    # --- linear programs over all active peaks
    # Trust region at first, where it ends, and at most, relative to the parameters.
    radius: float = 3e-2
    smallest_radius: float = 1e-8
    largest_radius: float = 0.5
    # Predicted decreases below this share of the value end the search. Smaller: more programs for less.
    worthwhile: float = 1e-8

    # --- the peak of one loop
    # Relative height above the largest value met at which the Hamiltonian is asked for crossings, and how often.
    peak_level: float = 1e-8
    peak_levels: int = 12
    # Frequencies of the first look, beside those of the poles.
    peak_grid: int = 28
    # Steps of the secant method at a peak.
    peak_refinements: int = 8
    # Eigenvalues of the Hamiltonian count as crossings up to this ratio of real part to modulus; sigma decides.
    near_axis: float = 1e-3
    # Residual of the entropy's Riccati equation, relative to its terms, above which a solution counts as none.
    entropy_residual: float = 1e-7

    # --- variables
    # Share of the range between two bounds that a start keeps away from them.
    inside: float = 1e-3

    # --- starts
    # The abscissa (scaled time) at which a start counts as stable, most steps to it, and those that go further inside.
    stable: float = -1e-6
    stabilise_steps: int = 300
    deeper_steps: int = 15
    deep: float = -0.5
    # Steps down the norm that a round gives every start, and how many starts go on to the next round.
    rounds: tuple[tuple[int, int], ...] = ((12, 8), (30, 4), (90, 3))
    round_rtol: float = 1e-5
    # Starts that are followed to the end of the path, and those of them that are polished. More: slower, seldom better.
    followed: int = 3
    polished: int = 2
    polish_rounds: int = 8
    polish_steps: int = 40
    # Ends whose norms differ by less than this share count as the same optimum.
    same: float = 1e-4

    # --- the central path
    # Weights of the barrier: the first finds the middle of the feasible set, the last ends within about a percent.
    barrier: tuple[float, ...] = (3.0, 1.0, 0.3)
    # Those for a start that has come down the norm already, and for a controller that is known to be good.
    barrier_closer: tuple[float, ...] = (0.1, 0.03)
    barrier_known: tuple[float, ...] = (0.3, 0.1, 0.03)
    barrier_steps: int = 60
    barrier_rtol: float = 1e-5
    # Level over the norm at which the path begins.
    headroom: float = 1.5
    # Steps of a descent on the norm itself.
    descent_steps: int = 40
    descent_rtol: float = 1e-6

    # --- a controller that is known
    # Condition number of the modes of A_K up to which they are taken as coordinates.
    modes_well_apart: float = 1e6
    # Dense quasi-Newton steps are quick up to this number of parameters; of larger controllers A_K stays as it is.
    many: int = 700


NONSMOOTH = NonsmoothTuning()


@dataclass(frozen=True)
class FixedTuning:
    """Controllers of fixed structure."""

    # Work of a design at effort 1.
    work: float = 60 * MILLION
    # Candidates that are verified, best first; the optimiser's own norm is not a proof. More: slower, seldom better.
    verified: int = 4

    # --- starts from other designs
    # Random starts of the search for the best static gain.
    static_starts: int = 6
    # Shares of the work left for it and for the full order, and most for that.
    static_share: float = 0.3
    full_share: float = 0.2
    full_work: float = 10 * MILLION
    # The full-order design may be so much worse than the best one: it is calmer then, and easier to reduce.
    full_hinf_rel: float = 1.05
    full_h2_rel: float = 1.0005
    # First and last pole of the states beside a static gain, in units of the plant's rate (discrete: in the z-plane).
    poles: tuple[float, float] = (0.3, 3.0)
    discrete_poles: tuple[float, float] = (0.2, 0.8)

    # --- the worst member of a set
    # Most scenarios.
    rounds: int = 12
    # Worst-case gain over the scenarios' gain at which the scenarios count as enough. Smaller: more rounds.
    enough: float = 1.01
    # Shares of the work that remains: for one design, and for one search for the worst member with its proof.
    design_share: float = 0.5
    search_share: float = 0.3


FIXED = FixedTuning()
