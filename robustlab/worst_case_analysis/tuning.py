"""Numbers that choose how long sampling and searching take and how much they see, in one place."""

from __future__ import annotations

from dataclasses import dataclass

from robustlab.budget import MILLION
from robustlab.shown import Tuning


@dataclass(frozen=True)
class WorstCaseTuning(Tuning):
    """Tuning of this wing; what is found is attained by a Delta whatever these numbers are.

    Work is counted in units of about a microsecond (`robustlab.budget`), shares are of it.
    """

    # --- the search (search) ---
    work: float = 60 * MILLION  # the usual work at effort 1
    climbing: float = 0.5  # share that the climbs may take, each an equal part
    vertices: int = 1024  # at most, beside the Sobol points
    climbs: int = 8  # local searches along gradients; more: more local maxima seen
    starts: int = 4  # compass searches where there are no gradients
    jumps: int = 6  # to the vertex that a gradient points to, at the beginning of a climb
    climb_steps: int = 40  # of the quasi-Newton method after them
    smallest_step: float = 1e-7  # of a compass search
    apart: float = 0.2  # starting points of climbs differ by this in one coordinate at least
    # --- many members at once (draws, ensemble) ---
    block: int = 512
    # members are computed in blocks that begin at its multiples: what comes out for a sample must not depend on how
    # many are drawn, nor on who computes its block; another size changes the last bits
    block_numbers: int = 2_000_000  # of large models, which take smaller blocks
    table: int = 4_000_000  # numbers of all L_k R_k up to which they are kept
    chunk: int = 2_000_000  # numbers of an intermediate array: memory, not the answer
    compiled_from: int = 20_000  # products per member from which loading the compiled kernel is worth its time
    zoom_points: int = 7  # of each round of the zoom on the highest grid point ...
    zoom_rounds: int = 8  # ... each of which narrows its bracket by a factor of 4
    grid_points: int = 48  # frequencies at which the gain of every member is looked at, besides those of its own poles
    # --- Gramians and responses (model_metrics, time_metrics) ---
    doublings: int = 46  # of the Smith iteration; a pole at 1e-12 of its size from the boundary is through by then
    taylor_reach: float = 0.25  # |A| h up to which a finite horizon begins as a Taylor series ...
    taylor_terms: int = 12  # ... of so many terms
    smallest_condition: float = 1e-13  # of the nominal Gramian, below which its directions are rounding
    panels: int = 32  # of the quadrature that re-evaluates a Gramian, at least ...
    nodes: int = 10  # ... with so many nodes each
    no_final_value: float = 1e-9  # share of a response's size below which a final value is zero
    # --- statistics (streaming, influence) ---
    bins: int = 256  # of the quantiles of a stream; more: finer quantiles, more memory ...
    fewest_bins: int = 16  # ... for long responses at least so many ...
    most_counts: int = 4_000_000  # ... in so many counts
    marginal: float = 1e-9  # share of the largest pole beyond the stability boundary that counts as unstable
    traces: float = 1e-6  # share of |A|^2 from which on the trace of A^2 is no rounding
    agreement: float = 1e-6  # to which a second simulation must repeat the worst responses
    influence_bins: int = 32  # along each parameter at most, for the share of the variance that it explains


TUNING = WorstCaseTuning()
