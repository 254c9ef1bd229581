"""Numbers that choose how long the search for robust performance takes and how close it comes, in one place."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.budget import MILLION
from robustlab.shown import Tuning


@dataclass(frozen=True)
class DKTuning(Tuning):
    """Tuning of `dk`; no number here decides whether a bound holds, only how small it gets and when.

    Work is counted in units of about a microsecond (`robustlab.budget`), shares are of it.
    """

    # --- the stages (dk_iteration) ---
    work: float = 120 * MILLION  # the usual work at effort 1
    start_share: float = 0.25  # for the H-infinity start; larger: a better first controller, less time for the rest
    structured_ends: int = 3  # ends of the search for a controller of given structure whose mu is looked at
    classical_end: float = 0.5  # where D-K iteration has to end when direct minimisation follows
    search_end: float = 0.8  # where the whole search has to end; the rest is for the proof
    softening_end: float = 0.85  # where the search for slower controllers has to end
    least_search: float = 0.3  # the search keeps this much even where the last curve of mu would need more
    iterations: int = 60  # of D-K; it usually settles long before
    fit_loss: float = 0.002  # loss at single frequencies that a fit of D may have; smaller: higher orders
    first_loss: float = 0.2  # the same where direct minimisation starts: a rough D of few states
    progress: float = 5e-4  # relative progress below which a stage ends; smaller: longer, hardly better
    rough_progress: float = 2e-2  # the same for D-K iteration where direct minimisation follows
    falls: int = 2  # enlargements of the scalings in a row below `progress` that end the search
    clearly: float = 0.9  # share of the peak of mu at which the nominal start is preferred
    few_blocks: int = 6  # above this many the direct search starts at constants fitted: from D = I the way is long
    many_blocks: int = 30  # from this many on the lower bound is sought at one frequency instead of four
    band_level: float = 0.3  # new sections are placed where mu is above this share of its peak ...
    beyond: float = 30.0  # ... and so many times beyond; larger: slower and faster sections
    last_curves: float = 1.5  # work kept for the end, in curves of mu ...
    curve_points: int = 112  # ... of so many frequencies
    proof_accuracy: float = 1e-3  # of the proof by intervals; smaller: more intervals
    alone_share: float = 0.02  # of the work for the level of one block of one member alone
    start_points: int = 16  # frequencies of the first loop at which mu of real blocks is computed
    # --- mu at single frequencies, and D(s) fitted to it (scalings_fit) ---
    first_points: int = 40  # frequencies before any is added
    rounds: int = 3  # rounds of refinement ...
    added: int = 24  # ... and frequencies added in each; more: fewer peaks missed, more work
    chunk: int = 8  # frequencies between two looks at the budget
    mu_tolerance: float = 1e-4  # of the upper bounds
    max_factor_order: int = 5  # of one factor of D
    sharpness: int = 24  # exponent of the mean that stands for the peak: smaller rewards lowering other peaks too
    room: float = 0.1  # error of log d at the peak that counts as one where mu is lower by e; larger: even weights
    tried: int = 6  # factors tried in a round, those whose fit is worst
    counted: float = 0.04  # zeros and poles lie where the weight is above this share of the largest one ...
    reach: float = 2.3  # ... and so far (logarithm) beyond: farther ones cost the synthesis digits, bring nothing
    fit_evaluations: int = 60  # of one least-squares fit
    # --- the smallest level by two Riccati equations (riccati_level) ---
    residual: float = 1e-7  # of a solution after Newton's steps; at 1e-3 levels passed that nothing could prove
    step: float = 1e-5  # of logarithmic parameters in derivatives of the frozen forms, which are smooth
    negligible: float = 1e-6  # eigenvalues of X Y below this share of the largest are noise
    steepest: float = 1e6  # logarithmic derivatives beyond this are rounding
    level_rtol: float = 1e-7  # of the smallest level
    max_tests: int = 40  # pairs of Riccati equations to bracket and find a level
    # --- direct minimisation (direct_minimisation) ---
    decrease: float = 1e-3  # share of the promised decrease that a step has to bring (Armijo)
    line_steps: int = 10  # trials of one line search
    first_scale: float = 1.0  # of the inverse Hessian before the first update
    within: float = 0.5  # branches so far (log beta) below the level belong to the model of a step ...
    most: int = 5  # ... and at most so many; more: kinks are seen earlier, each step costs more
    steps: int = 60  # of one minimisation
    step_progress: float = 2e-5  # relative progress in ...
    patience: int = 5  # ... so many steps below which a minimisation ends
    largest_move: float = 1.0  # of a logarithmic parameter in one step
    largest_range: float = 16.0  # logarithmic parameters further from the start are refused: they would run away
    places: int = 9  # places of a new section over frequency
    short: int = 10  # steps by which a candidate for a new section is followed ...
    pursued: int = 4  # ... and so many of the steepest candidates
    # --- controllers (robust_problem) ---
    # A central controller at the smallest level itself is ill-conditioned: the level is backed off by these shares
    # until the proof agrees. The last ones are for plants of such spread that digits are lost in the controller.
    backoff: tuple[float, ...] = (1e-4, 1e-3, 1e-2, 5e-2, 0.1, 0.2, 0.3, 0.4, 0.6, 1.0)
    accepted: float = 1e-2  # loss against the Riccati level above which the other numerical scaling is tried as well
    softer: tuple[float, ...] = (0.999, 0.8, 0.5)  # shares (of a logarithm) of the slack for slower controllers
    calmest: int = 4  # so many of the slowest controllers found are tried
    regular: float = 1e-6  # D12, D21 below this size in scaled units need regularisation
    rough: float = 0.1  # share of the loop's gain that regularisation may cost while iterating; smaller: stiffer
    fine: float = 0.03  # the same at the end
    state_share: float = 0.3  # of it for penalties and noises on the states
    nominal_share: float = 0.03  # disturbance on the control of the nominal start, of what the control does without it
    nominal_gamma_rel: float = 1.1  # factor above the smallest gamma that the nominal start's controllers may cost
    nominal_points: int = 80  # frequencies for the size of that control


TUNING = DKTuning()
