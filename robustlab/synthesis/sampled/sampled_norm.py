r"""The H-infinity norm of a loop of continuous plant, sampler, digital controller and hold, between the samples too.

With Q the mean over each interval of a period and Q' = I - Q, :math:`\|T Q\|` bounds the norm from below, and the norm
of the 2 x 2 matrix of the gains of Q T Q, Q T Q', Q' T Q, Q' T Q' from above.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.budget import one_thread
from robustlab.checks import number
from robustlab.display import Facts, listed
from robustlab.display import number as in_words
from robustlab.errors import InputError, error_context
from robustlab.feedback import wired
from robustlab.norms import HinfNorm, PeakGain, hinf_norm
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model, lower_lft, series
from robustlab.synthesis.problem.certify import certified
from robustlab.synthesis.problem.partition import GeneralizedPlant, as_generalized_plant, require_performance
from robustlab.synthesis.sampled.lifting import LiftedPlant, lift

INTERVALS = (2, 4, 8, 16, 32, 64)  # of a period, tried in this order until the bracket is closed
MOST_LIFTED = 256  # lifted disturbance or performance channels at most: norms cost their cube

LONGEST_DELAY = 1000  # samples: each is a state of every control


@dataclass(frozen=True, eq=False)
class SampledDataNorm(PeakGain):
    """Norm of a sampled-data loop as a bracket.

    Attributes
    ----------
    value
        ``upper``.
    lower, upper
        ``lower <= norm <= upper``: ``lower`` is the gain of a disturbance that is constant on the intervals, ``upper``
        holds for all. Both inf where the loop is not stable.
    frequency
        Frequency in rad/s, from 0 to pi / dt, of the loop over whole periods at which ``lower`` is attained.
    n_intervals
        Number of intervals of a period in the end.
    history
        ``(n_intervals, lower, upper)`` of every step.
    held
        Names of the disturbances that change at the samples only, because they reach the sampler directly.
    loop
        The discrete closed loop over whole periods, whose norm is ``lower``: from the means of w to the means and rests
        of z.
    status
        CERTIFIED: the bracket is proved and closed to the requested tolerance. CONVERGED: ``lower`` has settled to it,
        the proved bracket is wider. INACCURATE: neither.
    reason
        Why it is not certified, or infinite; else empty.
    """

    frequency: float
    n_intervals: int
    history: tuple[tuple[int, float, float], ...]
    loop: StateSpaceModel
    held: tuple[str, ...]
    reason: str = ""

    unsaved: ClassVar[tuple[str, ...]] = ("loop",)
    unstable: ClassVar[str] = "infinite: the loop is not stable"

    @property
    def value(self) -> float:
        """``upper``."""
        return self.upper

    def evidence(self) -> Facts:
        """Return the sampling, and the assumptions between the samples."""
        return [
            ("sample time", in_words(self.loop.dt, "s")),
            ("intervals of a period", str(self.n_intervals)),
            ("taken as constant between samples", listed(self.held)),
            ("reason", self.reason),
        ]


@error_context("sampled_data_norm")
def sampled_data_norm(
    plant: Any,
    K: Any,
    *,
    delay: float = 0.0,
    antialiasing: float | None = None,
    n_meas: int | None = None,
    n_con: int | None = None,
    rtol: float = 1e-2,
) -> SampledDataNorm:
    r"""Bound the H-infinity norm from w to z of a continuous plant with a digital controller, also between samples.

    The measurements are sampled at ``k dt``, the controls change at ``k dt + delay`` and are held (zero order).

    Parameters
    ----------
    plant
        Continuous generalised plant (see `hinf`).
    K
        Discrete controller, ``u = K y``; its dt is the sample time.
    delay
        Computational delay in s, of any length.
    antialiasing
        Corner frequency in rad/s of a first-order low-pass filter before the sampler, on every measurement that w or u
        reach directly; w then is any disturbance of finite energy. Where left out, those that reach the sampler
        directly change at the samples only (``held`` names them).
    n_meas, n_con
        Numbers of measurements and controls, where a plain plant is given.
    rtol
        Relative width of the bracket that ends the refinement.

    Returns
    -------
    SampledDataNorm
        The bracket, the frequency of the peak, and the loop over whole periods.

    Raises
    ------
    InputError
        A discrete plant, a continuous K, sizes that do not fit, a negative delay, a loop that is not well posed.

    References
    ----------
    Chen, Francis, *Optimal Sampled-Data Control Systems* (1995), chapters 10, 13.

    Examples
    --------
    >>> P = StateSpaceModel([[-1.0]], [[1.0, 1.0]], [[1.0], [1.0]], [[0, 0], [0, 0]])  # x' = -x + w + u, z = y = x
    >>> norm = sampled_data_norm(P, StateSpaceModel([], [], [], [[-3.0]], 0.01), n_meas=1, n_con=1)
    >>> norm.status.value, 0.25 < norm.lower < norm.upper < 0.254
    ('certified', True)
    """
    where = "sampled_data_norm"
    k = as_model(getattr(K, "K", K), f"{where}: K")
    p = as_generalized_plant(plant, n_meas or k.n_inputs, n_con or k.n_outputs, where)
    require_performance(p, where)
    check_sampling(p, k, k.dt, delay, where)
    if not 0 < rtol < 1:
        raise InputError(where, f"rtol is {rtol}", "between 0 and 1")
    k = wired(k, p.measurements, p.controls, where)
    with one_thread():
        return sampled_loop_norm(with_antialiasing(p, antialiasing, where), k, delay, rtol)


def check_sampling(plant: GeneralizedPlant, K: StateSpaceModel, dt: float, delay: float, where: str) -> None:
    """Require a continuous plant, a positive sample time, no negative delay, and a controller that fits."""
    if plant.model.dt:
        raise InputError(where, f"the plant has dt = {plant.model.dt:g} s", "a continuous plant (dt = 0)")
    number(f"{where}: sample time", dt, "a positive time in s", "discretise the controller first", above=0)
    if not 0 <= delay <= LONGEST_DELAY * dt:
        raise InputError(where, f"delay is {delay}", f"a time in s, not negative, of at most {LONGEST_DELAY} samples")
    if (K.n_outputs, K.n_inputs) != (plant.n_con, plant.n_meas):
        raise InputError(where, f"K is {K.n_outputs} x {K.n_inputs}", f"{plant.n_con} x {plant.n_meas}")


def with_antialiasing(plant: GeneralizedPlant, corner: float | None, where: str) -> GeneralizedPlant:
    r"""Add :math:`1 / (s / \omega_f + 1)` to the measurements that w or u reach directly (D21, D22)."""
    if corner is None:
        return plant
    if not 0 < corner < np.inf:
        raise InputError(where, f"antialiasing is {corner}", "a positive corner frequency in rad/s")
    m, n_z = plant.model, plant.n_z
    select = np.eye(m.n_outputs)[:, n_z + np.flatnonzero(m.D[n_z:].any(axis=1))]
    k = select.shape[1]
    filters = StateSpaceModel(-corner * np.eye(k), corner * select.T, select, np.eye(m.n_outputs) - select @ select.T)
    behind = series(StateSpaceModel(m.A, m.B, m.C, m.D), filters)
    return GeneralizedPlant(behind.renamed(m.inputs, m.outputs), plant.n_meas, plant.n_con, plant.blocks)


def sampled_loop_norm(
    plant: GeneralizedPlant, K: StateSpaceModel, delay: float, rtol: float, enough: float = np.inf
) -> SampledDataNorm:
    """Bound the norm with more and more intervals until the bracket is closed, or ``lower`` exceeds ``enough``."""
    K = StateSpaceModel(K.A, K.B, K.C, K.D, K.dt)
    history: list[tuple[int, float, float]] = []
    best: SampledDataNorm | None = None
    lifted: LiftedPlant | None = None
    for n_intervals in INTERVALS:
        if best is not None and n_intervals * max(plant.n_w, plant.n_z) > MOST_LIFTED:
            break
        lifted = lift(plant, K.dt, n_intervals, delay)
        found = _bracket(lifted, lower_lft(lifted.model, K), min(1e-4, 0.1 * rtol))
        history.append((lifted.n_intervals, found.lower, found.upper))
        lower, upper = max(h[1] for h in history), min(h[2] for h in history)
        settled = len(history) > 1 and history[-1][1] <= history[-2][1] * (1 + rtol / 3)
        status, reason = found.status, found.reason
        if np.isfinite(upper) and status is Status.CERTIFIED and upper > lower * (1 + rtol):
            status = Status.CONVERGED if settled else Status.INACCURATE
            reason = f"the proved bracket is {100 * (upper / lower - 1):.2g} % wide" if lower else "the bracket is open"
        best = replace(found, lower=lower, upper=upper, status=status, history=tuple(history), reason=reason)
        if not np.isfinite(upper) or upper <= lower * (1 + rtol) or upper == 0 or lower > enough:
            break
    assert best is not None
    assert lifted is not None
    return best if best.lower > enough or not np.isfinite(best.upper) else _confirmed(best, lifted, K)


def _confirmed(norm: SampledDataNorm, lifted: LiftedPlant, K: StateSpaceModel) -> SampledDataNorm:
    """Return the norm; INACCURATE unless that of the lifted plant and K as stored is proved to be in the bracket."""
    plant = lifted.generalized_plant()
    m, n_z = plant.model, plant.n_z
    few = _few_outputs(m, slice(0, n_z))
    C, D = np.vstack([few.C, m.C[n_z:]]), np.vstack([few.D, m.D[n_z:]])
    narrow = GeneralizedPlant(StateSpaceModel(m.A, m.B, C, D, m.dt), plant.n_meas, plant.n_con)
    proof = certified(narrow, K, HinfNorm(norm.lower, norm.upper, norm.frequency, norm.status), norm.upper)
    return replace(norm, upper=proof.gamma, status=Status.INACCURATE, reason=proof.doubt) if proof.doubt else norm


def _bracket(lifted: LiftedPlant, loop: StateSpaceModel, rtol: float) -> SampledDataNorm:
    """Return the bracket of one number of intervals."""
    n, n_mean = lifted.n_w, lifted.n_means
    w, kick = slice(0, n), slice(n, n + lifted.n_kick)
    mean, rest = slice(0, n_mean), slice(n_mean, n_mean + lifted.n_rests)
    whole = loop.select(loop.input_names[w], loop.output_names[: rest.stop])

    def norm(rows: slice, columns: slice, rtol: float) -> HinfNorm:
        return hinf_norm(_few_outputs(loop, rows, columns), rtol)

    lower = norm(slice(0, rest.stop), w, rtol)
    upper, norms = lower.upper, [lower]
    if np.isfinite(upper) and len(lifted.held) < n:  # if all of w is held, it has no rest
        norms.append(norm(mean, w, rtol))
        b, c, d = (norm(i, j, 1e-2).upper for i, j in ((mean, kick), (rest, w), (rest, kick)))
        gains = np.array([[norms[1].upper, b + lifted.to_mean], [c, d + lifted.to_rest]])
        upper = max(float(np.linalg.norm(gains, 2)), upper)
    doubtful = next((norm for norm in norms if norm.status is not Status.CERTIFIED), None)
    status = Status.CERTIFIED if doubtful is None else Status.INACCURATE
    held = tuple(loop.input_names[i] for i in range(n - len(lifted.held), n))
    reason = (doubtful or lower).reason
    return SampledDataNorm(lower.lower, upper, lower.frequency, status, lifted.n_intervals, (), whole, held, reason)


def _few_outputs(m: StateSpaceModel, rows: slice, columns: slice = slice(None)) -> StateSpaceModel:
    """Return a part of a model; an orthogonal transformation leaves no more outputs than states and inputs."""
    out = np.hstack([m.C[rows], m.D[rows, columns]])
    if len(out) > out.shape[1]:
        out = np.asarray(np.linalg.qr(out, mode="r"))
    return StateSpaceModel(m.A, m.B[:, columns], out[:, : m.n_states], out[:, m.n_states :], m.dt)
