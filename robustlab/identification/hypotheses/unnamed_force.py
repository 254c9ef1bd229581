r"""Evidence that a force without a name acts on top of a hypothesis: a Gaussian process over what it may depend on.

Near the fit of a hypothesis S the errors of a window, in units of the sensors' noise, are linear in everything small
(`robustlab.identification.hypotheses.force_response`):

.. math::
    e = J\,\delta + X\,\eta + O\,(\Phi c + d) + \text{noise}, \qquad z + \delta \sim N(0, 1), \quad
    \xi + \eta \sim N(0, 1), \quad d \sim N(0, s^2 K_f), \quad c \sim N(0, \lambda^2)

with a random force d of bandwidth f and size s (no machine runs without), and an unnamed force :math:`\Phi c` that
follows the speed, the position, the time or the input, smoothly or as a line. All but the three numbers (s, f, lambda)
is Gaussian: the marginal likelihoods of S alone and of S with the unnamed force are closed forms, each maximised over
its own s, f and the common scale of the noise, lambda paid for by the number tried, a line by the number of lines
searched. What is gained is in nats, to be added to the log evidence of S.

So S is not charged with what is random, and nothing is credited to a curve that a random force explains as well. The
second judge is `cross_validated`: what each window gains by curves told by all the others.

References
----------
Rasmussen, Williams, *Gaussian Processes for Machine Learning* (2006), sections 2.7 and 5.4; MacKay, "Bayesian
interpolation", Neural Computation 4 (1992).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from robustlab.arrays import Array
from robustlab.dynamics.effects.contract import Site
from robustlab.dynamics.plant_contract import NonlinearPlant
from robustlab.errors import RobustlabError
from robustlab.identification.hypotheses.effect_fit import Fit, Problem
from robustlab.identification.hypotheses.force_families import Family, Over, families
from robustlab.identification.hypotheses.force_response import force_response, plain_places
from robustlab.identification.hypotheses.random_force import FittedWindows, NoiseLevel, eliminated

__all__ = ["PRIOR", "UNTOLD", "Unnamed", "UnnamedEvidence", "fitted_windows", "unnamed_force"]

PRIOR = 0.05  # probability that something acts that is not in the catalogue, before any data
# What the sums end with where there is hardly any motion, or nothing that tells some parameter.
UNTOLD = (RobustlabError, np.linalg.LinAlgError, ValueError, ArithmeticError)
STRENGTHS = 10.0 ** np.arange(-3.5, 0.1, 0.5)  # lambda, of the force that moves the port


@dataclass(frozen=True, eq=False)
class UnnamedEvidence:
    """An unnamed force on top of a hypothesis, against the hypothesis alone."""

    # port, over, coordinate, dry: where it acts, what it follows (of an input: which); ``dry`` where it turns round
    # with the direction of motion
    port: str
    over: Over
    coordinate: str
    dry: bool
    # gain in log evidence, in nats; what was searched is paid for, the prior of an unnamed force is not
    evidence: float
    cross_validated: float  # gain in log predictive density, window by window, with the curve told by all the others
    fall: float  # by how much the cost falls, at the noise of the hypothesis with the force
    share: float  # of what the hypothesis leaves beyond that noise, which share goes; 0..1
    rms: float  # of the force along the records
    # x, force, std: the curve: coordinate, force and its standard deviation; of a line over one period
    x: Array
    force: Array
    std: Array
    # unit, coordinate_unit: of the force and of the coordinate
    unit: str
    coordinate_unit: str
    # period, amplitude, amplitude_std: of a line; NaN for a curve. ``period`` in ``coordinate_unit``.
    period: float = float("nan")
    amplitude: float = float("nan")
    amplitude_std: float = float("nan")

    @property
    def wins(self) -> bool:
        """Whether it is more probable than nothing, its prior included, and helps on data that it was not told."""
        return self.evidence > -np.log(PRIOR) and self.cross_validated > 0.0


@dataclass(frozen=True, eq=False)
class Unnamed:
    """What a hypothesis leaves."""

    forces: tuple[UnnamedEvidence, ...]  # best first
    # RMS error of the fit, starts and parameters at their best, over what the sensors' noise and the machine's random
    # force make of it; the random force is what no unnamed force explains
    noise_ratio: float
    # random_force, random_share, bandwidth: its RMS in the unit of the port and over that of the force that moves the
    # port, and its bandwidth in Hz
    random_force: float
    random_share: float
    bandwidth: float


def fitted_windows(problem: Problem, fit: Fit) -> tuple[tuple[FittedWindows, Site], ...]:
    """What a hypothesis leaves in the windows under a random force, and where curves of a force are to be looked for.

    Of a linear plant with few joints (``most_places``) the random force acts at one of them, and each is asked; of
    any other at all of them, and those are asked where more than it is left.
    """
    places, most = plain_places(problem, fit), problem.tuning.most_places
    if len(places) <= most and not isinstance(problem.plant, NonlinearPlant):
        return tuple((FittedWindows(force_response(problem, fit, [p]), fit.z, problem), p) for p in places)
    everywhere = FittedWindows(force_response(problem, fit, places), fit.z, problem)
    return tuple((everywhere.at(k), places[k]) for k in everywhere.strongest()[:most])


def unnamed_force(windows: FittedWindows, place: Site) -> Unnamed:
    """What a hypothesis leaves, told as a force at one place."""
    kinds = families(windows)
    best = [_judged(windows, family, len(kinds)) for family in kinds]
    told = [_told(windows, place, f, b) for f, b in zip(kinds, best, strict=True)]
    order = sorted(range(len(told)), key=lambda k: (not told[k].wins, -told[k].evidence))
    first = best[order[0]]
    level, rest = (first.level, first.q) if told[order[0]].wins else (windows.alone, windows.alone.alone_q)
    # What is called the sensors' noise was told by the nominal model, and is too large where that is late or scaled.
    ratio = float(np.sqrt(level.alone_q / min(windows.points, rest)))
    return Unnamed(tuple(told[k] for k in order), ratio, level.size * windows.force, level.size, level.bandwidth)


class _Best(NamedTuple):
    """The best noise and strength of one family, and what comes of them."""

    level: NoiseLevel
    strength: float
    evidence: float
    cross_validated: float
    q: float
    mean: Array
    covariance: Array


def _judged(windows: FittedWindows, family: Family, kinds: int) -> _Best:
    """One of so many kinds at its own best noise and strength."""
    n_z, n, count = len(windows.z), windows.points, family.columns[0].shape[2]
    levels = windows.levels(family.columns, windows.smaller)
    alone = max(level.alone for level in [*levels, windows.alone])
    strengths = (STRENGTHS * windows.force) ** 2
    found = None
    for level in levels:
        h, b, det = _projected(windows.with_prior(level.gram.sum(axis=0)), count, n_z)
        w, u = np.linalg.eigh(h)
        w = np.maximum(w, 0.0)
        seen = (u.T @ b) ** 2
        q = level.alone_q - (seen * (strengths[:, None] / (1.0 + strengths[:, None] * w))).sum(axis=1)
        q = np.maximum(q, 1e-12 * level.alone_q)
        logdet = np.log1p(strengths[:, None] * w).sum(axis=1) + level.logdet.sum() + det
        p = -0.5 * n * np.log(q / n) - 0.5 * logdet
        at = int(p.argmax())
        if found is None or p[at] > found[0]:
            found = (float(p[at]), level, strengths[at], float(q[at]))
    assert found is not None
    p, level, strength, q = found
    cv = _cross_validated(windows, level.gram, count, strength, windows.alone, level, q)
    h, b, _ = _projected(windows.with_prior(level.gram.sum(axis=0)), count, n_z)
    inner = np.linalg.inv(h + np.eye(count) / strength)
    evidence = p - alone - np.log(len(STRENGTHS) * kinds) - family.price
    return _Best(level, strength, float(evidence), cv, q, inner @ b, inner * q / n)


def _projected(gram: Array, count: int, n_z: int) -> tuple[Array, Array, float]:
    """Normal equations of the family with the parameters eliminated, and log det of the parameters' equations."""
    if n_z == 0:
        return gram[:count, :count], gram[:count, -1], 0.0
    inner = gram[count:-1, count:-1]
    solved = np.linalg.solve(inner, gram[count:-1])
    rest = gram - gram[:, count:-1] @ solved
    return rest[:count, :count], rest[:count, -1], float(np.linalg.slogdet(inner)[1])


def _cross_validated(
    windows: FittedWindows, gram: Array, count: int, strength: float, alone: NoiseLevel, level: NoiseLevel, q: float
) -> float:
    """Sum over the windows of the log predictive density given the others, with the family less without."""
    n_z, n = len(windows.z), windows.points
    points = np.concatenate([r.points for r in windows.records])

    def predictive(grams: Array, logdet: Array, k: int, scale: float) -> float:
        total = grams.sum(axis=0)
        every = np.concatenate([total[None], total - grams])
        every = windows.with_prior(every)
        if k:
            every[:, :k, :k] += np.eye(k) / strength
        v, det = eliminated(every, k + n_z)
        p = -0.5 * v / scale - 0.5 * det
        return float(np.sum(p[0] - p[1:] - 0.5 * logdet - 0.5 * points * np.log(scale)))

    without = alone.gram[:, -n_z - 1 :, -n_z - 1 :]
    return predictive(gram, level.logdet, count, q / n) - predictive(without, alone.logdet, 0, alone.alone_q / n)


def _told(windows: FittedWindows, place: Site, family: Family, best: _Best) -> UnnamedEvidence:
    """The evidence with the force drawn."""
    n = windows.points
    fall = (best.level.alone_q - best.q) / (best.q / n)
    beyond = best.level.alone_q / best.q * n - n
    share = float(np.clip(fall / beyond, 0.0, 1.0)) if beyond > 0 else 0.0
    along = np.concatenate([(c @ best.mean).ravel() for c in family.columns])
    drawn = family.basis(family.grid)
    mean, covariance, dry = best.mean, best.covariance, family.dry
    period = amplitude = amplitude_std = float("nan")
    if family.wave:
        # Of a line over the position the part that is the same both ways, or the one that turns round with the motion.
        dry = family.over == "line over position" and np.hypot(*mean[2:4]) > 1.01 * np.hypot(
            *mean[:2]
        )  # not by rounding
        if dry:
            mean, covariance = np.roll(mean, -2), np.roll(covariance, -2, axis=(0, 1))
        period, amplitude = 1.0 / family.wave, float(np.hypot(*mean[:2]))
        amplitude_std = float(np.sqrt(0.5 * (covariance[0, 0] + covariance[1, 1])))
    std = np.sqrt(np.maximum(np.einsum("mk,kl,ml->m", drawn, covariance, drawn), 0.0))
    return UnnamedEvidence(
        place.name, family.over, family.coordinate, bool(dry), best.evidence, best.cross_validated, float(fall), share,
        float(np.sqrt(np.mean(along**2))),
        family.grid, drawn @ mean, std, windows.records[0].motion.unit, family.unit, period, amplitude, amplitude_std,
    )  # fmt: skip
