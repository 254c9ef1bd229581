"""What a search for the smallest Delta is given: the blocks, the precision, the budget, and the numbers it is tuned by.

The tuning chooses how long a search goes on and how finely it looks; whatever it is, bounds hold as they are labelled.
Rounding (what counts as zero) is no tuning and stays where it is used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from robustlab.arrays import Array, Mask
from robustlab.budget import MILLION, Budget
from robustlab.shown import Tuning


@dataclass(frozen=True)
class ValidationTuning(Tuning):
    """Numbers that choose speed and accuracy of `robustlab.validate`."""

    # What a validation may cost, in units of `robustlab.budget`: about two minutes. More work, tighter bounds.
    work: float = 120 * MILLION

    # --- records: longer ones are judged by their beginning, a weaker test
    # Samples of a cone programme over all of them: so many take some 10 s.
    longest_programme: int = 8000
    # Unknowns and samples of pulse responses, a dense problem whose work grows with the cube.
    most_unknowns: int = 2000
    longest_pulses: int = 700
    # Samples from which the lower bound comes where constants and systems stand side by side.
    longest_relaxed: int = 4000

    # --- constants beside systems: pattern search over the constants
    constants_share: float = 0.4  # of the budget; what is left explains the record at the constants found
    finest_step: float = 0.02  # of the size reached, at which the search ends: smaller finds a smaller upper bound

    # --- time-varying systems
    noise_margin: float = 1e-7  # by which the solver aims inside the noise bound: larger replays surely, costs gamma
    varying_rounds: int = 25  # convex-concave steps at most
    sweep_work: float = 250.0  # a sample, of finding what multipliers disprove: some 15 sweeps over the record
    sweep_steps: int = 30  # sweeps at most on the way down to a gamma that is disproved
    ahead: float = 3.0  # energy of z that the first guess has in advance: larger, and no early sample decides
    # Shares of the record at whose beginning a weaker problem leaves out the conditions on the energies; more of them
    # are tried only while the lower bound is not there.
    late: tuple[float, ...] = (0.004, 0.02, 0.1)

    # --- time-invariant systems: central path
    path_steps: int = 200  # Newton steps at most
    kept: float = 0.85  # a step keeps at least this share of the way to the boundary before it: larger, shorter steps
    gauss_newton_rounds: int = 8  # where z is not known
    # The path's parameter grows by ``faster``; by ``slower`` after a centring that took more than ``usual_steps``, as
    # where many singular values come to the bound together (an all-pass). One of more than ``long_steps`` starts again
    # from the last centred point, with the root of the factor (``slowest`` at least) from there on.
    faster: float = 10.0
    slower: float = 3.0
    slowest: float = 1.5
    usual_steps: int = 7
    long_steps: int = 20
    # A point counts as centred where the squared Newton decrement is below ``centred``: Newton steps converge from
    # there. Far from the end of the path one that ``falls`` this fast, and is below the share ``roughly`` of the
    # barrier's parameter, is as good.
    centred: float = 1.0
    falls: float = 0.1
    roughly: float = 0.01
    reserve: float = 1e-4  # of the noise bound, that the linearised problem leaves to its own error
    far: float = 1e6  # a start by least squares that is larger than the guess by this factor is worse than none
    penalties: tuple[float, ...] = (3.0, 1e2, 1e4)  # on noise beyond its bound, one after the other

    # --- constants: descent, then branch and bound
    spare: float = 0.25  # of a witness' variation over a box, to spare at the points: larger is surer, more boxes
    widest: float = 1e3  # parameters beyond this many times their range are not tried
    moves: int = 40  # of a descent
    move_exchanges: int = 20  # programmes over a few samples each, of one move
    first_boxes: int = 60  # that often show that there is nothing to be found
    # After so many moves in a row that leave more than this share of what is beyond the noise bound no more is tried.
    creep: float = 0.995
    creeps: int = 3
    fit_exchanges: int = 60  # of a fit of free states in the largest deviation
    kept_numbers: int = 4_000_000  # of simulated members that are kept in memory: more, fewer simulations
    programme_work: float = 3000.0  # of a linear programme, besides its entries
    simulation_work: float = 500.0  # of a simulation, besides its samples
    fitting_work: float = 5000.0  # of a fit by linear programmes

    # --- lines
    line_rounds: int = 30  # convex-concave steps at most
    line_margin: float = 1e-9  # by which the programmes aim inside the noise bound
    halvings: int = 60  # of the interval in which a disproved gamma is looked for

    # --- the solver
    most_iterations: int = 200
    fewest_iterations: int = 20  # that any programme gets, however little of the budget is left
    building_work: float = 2.0  # of setting a programme up, per stored entry, as measured
    iteration_work: float = 0.5  # of an iteration, per stored entry, as measured

    # --- what is asked of a user who does not say
    confidence: float = 0.99  # that noise stays within a bound taken from repeats: larger, wider bounds
    least_radius: float = 0.02  # of `data_cover`: no plant is known better than this at every frequency


TUNING = ValidationTuning()


@dataclass(frozen=True)
class Search:
    """What every search for the smallest gamma is given."""

    scaled: Mask  # the blocks that gamma scales, (n_blocks,); the others keep the size 1
    precision: float  # relative width of the bounds to be reached
    budget: Budget  # work it may take
    tuning: ValidationTuning = TUNING  # its numbers

    def gammas(self, gamma: float) -> Array:
        """Sizes of the blocks that belong to a gamma."""
        return np.where(self.scaled, gamma, 1.0)
