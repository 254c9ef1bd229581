"""Numbers that choose speed and accuracy, at their measured defaults; what is returned is proved whatever they are."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.shown import Tuning


@dataclass(frozen=True)
class NonsmoothTuning(Tuning):
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


TUNING = NonsmoothTuning()
