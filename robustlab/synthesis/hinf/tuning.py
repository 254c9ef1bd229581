"""Numbers that choose speed and accuracy, at their measured defaults; what is returned is proved whatever they are."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.budget import MILLION
from robustlab.shown import Tuning


@dataclass(frozen=True)
class HinfTuning(Tuning):
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
    # Largest eigenvalue of R and S in the coordinates of the solver: without it many optima are not attained.
    lmi_bound: float = 1e5

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


TUNING = HinfTuning()
