"""Robust stability and robust performance of an uncertain continuous plant under a digital controller, proved."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.mu_analysis.margin import Margin
from robustlab.mu_analysis.stability import robust_stability
from robustlab.mu_analysis.worst_gain import PERFORMANCE, robust_performance
from robustlab.result import Status
from robustlab.statespace import StateSpaceModel, as_model
from robustlab.synthesis.partition import GeneralizedPlant, as_generalized_plant
from robustlab.synthesis.sampled_data import check_sampling, sampled_loop_norm, with_antialiasing
from robustlab.synthesis.sampled_uncertainty import REST, sample_uncertain_plant
from robustlab.synthesis.tracking_problem import TrackingProblem
from robustlab.uncertainty.blocks import RealScalar
from robustlab.uncertainty.lft import UncertainModel

__all__ = ["SampledRobustness", "sampled_robustness"]

WHERE = "sampled_robustness"
DEGREES = (1, 2, 3)
# Accuracy of the proofs, and of the norm of a member.
PROOF, MEMBER = 1e-3, 1e-2
# Sizes of the worst direction that are tried for the member that attains most.
SIZES = 6


@dataclass(frozen=True, eq=False)
class SampledRobustness:
    r"""Robustness of a sampled loop; the bounds hold for the continuous signals, between the samples too.

    Attributes
    ----------
    stability
        Margin of robust stability: the loop is stable for every Delta of norm below ``stability.lower``.
    performance
        Margin of robust performance: for every Delta of norm below k = ``performance.lower`` the gain from disturbances
        to performance is below 1 / k; None where the plant has no such channels.
    mu_lower
        Attained by ``member``: ``min(1 / size, gain)`` of it. Dynamic blocks are zero in it.
    member, member_gain
        The Delta of real parameters that attains ``mu_lower``, and a lower bound of its sampled-data norm.
    loop
        The uncertain discrete loop that was proved: ``rl.robust_performance(loop)`` proves it again. Its blocks are those
        of the plant on the signals of a period, and the covers called ``"rest of ..."``.
    degree
        Number of polynomials on each interval of constant control, in ``loop``.
    history
        ``(degree, mu_upper)`` of every step.
    dt, delay, antialiasing
        Sample time and computation delay in s; corner of the filter before the sampler in rad/s or None.
    held
        Disturbances taken as constant between samples, because they reach the sampler directly.
    widened
        Blocks that a larger one covers: repeated dynamic scalars.
    status
        CERTIFIED: the margins are proved. TIMEOUT: not in time; ``mu_upper`` is inf.
    notes
        What a reader must know.
    """

    stability: Margin
    performance: Margin | None
    mu_lower: float
    member: Mapping[str, float]
    member_gain: float
    loop: UncertainModel
    degree: int
    history: tuple[tuple[int, float], ...]
    dt: float
    delay: float
    antialiasing: float | None
    held: tuple[str, ...]
    widened: tuple[str, ...]
    status: Status
    notes: tuple[str, ...]

    @property
    def margin(self) -> float:
        """Proved margin: of robust performance, or of stability where there is no performance."""
        return (self.performance or self.stability).lower

    @property
    def mu_upper(self) -> float:
        """``1 / margin``: proved upper bound of mu; inf where nothing is proved."""
        return _inverse(self.margin)

    def summary(self) -> list[tuple[str, str]]:
        """What a person wants to read, as (label, text)."""
        what = "robust performance" if self.performance else "robust stability"
        delay = f", delay {self.delay:g} s" if self.delay else ""
        worst = ", ".join(f"{name} = {value:.4g}" for name, value in self.member.items())
        rows = [
            ("sampled loop", f"dt = {self.dt:g} s{delay}"),
            (f"mu, {what}", f"{self.mu_lower:.4g} .. {self.mu_upper:.4g} (attained .. proved)"),
            ("margin", f"{self.margin:.4g}"),
            ("stability margin", f"{self.stability.lower:.4g}"),
            ("worst member found", f"{worst}: gain {self.member_gain:.4g}" if worst else ""),
            ("taken as constant between samples", ", ".join(self.held)),
            ("status", self.status.value),
        ]
        return [row for row in rows if row[1]] + [("note", text) for text in self.notes]

    def to_json(self) -> dict[str, Any]:
        """All attributes but the loop, and the margin."""
        names = [name for name in self.__dataclass_fields__ if name != "loop"]
        data = {name: getattr(self, name) for name in names}
        return {"type": "SampledRobustness", **data, "margin": self.margin, "mu_upper": self.mu_upper}


def sampled_robustness(
    plant: Any,
    K: Any,
    *,
    delay: float = 0.0,
    antialiasing: float | None = None,
    n_meas: int | None = None,
    n_con: int | None = None,
    degree: int | None = None,
    accuracy: float = 0.01,
    time_limit: float = 60.0,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> SampledRobustness:
    r"""Robust stability and performance of an uncertain continuous plant with a digital controller, for the true loop.

    The measurements are sampled at ``k dt``, the controls change at ``k dt + delay`` and are held. What is proved holds
    for every member of the continuous set, each with its own exact discretisation, and for the energies of the
    continuous signals, between the samples too:

    .. math:: \| F_u(F_l(P, H K_d S), \Delta) \| \le \frac1k \quad \text{for all} \ \|\Delta\| \le k

    Real parameters are constant; dynamic blocks are any linear operators of their norm whose action repeats with the
    sample time (Delta(s) among them). The plant is lifted over a period with polynomials of growing degree
    (`sample_uncertain_plant`), and the interval proof of `robust_performance` covers the unit circle.

    Parameters
    ----------
    plant
        Continuous generalised plant with its blocks, tracking problem, or uncertain model with the channels of Delta
        first and u, y last.
    K
        Discrete controller, ``u = K y``; its dt is the sample time.
    delay
        Computation delay in s, of any length.
    antialiasing
        Corner in rad/s of a first-order filter before the sampler, on every measurement that is reached directly.
    n_meas, n_con
        Numbers of measurements and controls, where an uncertain model is given.
    degree
        Number of polynomials; where left out 1, 2, 3 are tried until mu changes by less than ``accuracy``.
    accuracy
        Relative change of mu that ends the refinement.
    time_limit
        Time in s for all proofs.
    seed
        Seed of the searches.
    progress
        Called with one line for each degree.

    Raises
    ------
    InputError
        A discrete plant, a continuous K, sizes that do not fit, a negative delay, a dynamic block that reaches the
        sampler directly and no filter.
    NoTrustworthyNumber
        The nominal sampled loop is not stable, or modes too fast for the sample time.

    References
    ----------
    Dullerud, Glover (1993); Sivashankar, Khargonekar (1993); Chen, Francis, *Optimal Sampled-Data Control Systems*.

    Examples
    --------
    >>> M = StateSpaceModel([[-1.0]], [[-0.3, 1.0, 1.0]], [[1.0]] * 3, [[0.0] * 3] * 3)
    >>> robust = sampled_robustness(UncertainModel(M, [RealScalar("pole")]), StateSpaceModel([], [], [], [[-3.0]], 0.05))
    >>> robust.status.value, robust.mu_lower <= robust.mu_upper <= 1.01 * robust.mu_lower
    ('certified', True)
    """
    p, k = _checked(plant, K, n_meas, n_con, delay)
    if degree is not None and (isinstance(degree, bool) or not isinstance(degree, int) or not 1 <= degree <= 6):
        raise InputError(WHERE, f"degree is {degree!r}", "a whole number from 1 to 6")
    if not 0 < accuracy < 1 or not time_limit > 0:
        raise InputError(WHERE, f"accuracy {accuracy}, time_limit {time_limit}", "0 < accuracy < 1 and a positive time")
    filtered = with_antialiasing(p, antialiasing, WHERE)
    from threadpoolctl import threadpool_limits

    with threadpool_limits(limits=1):  # small matrices: one BLAS thread is the quickest
        proofs = _Proofs(filtered, k, float(delay), time.monotonic() + time_limit, seed, progress)
        proofs.refine(DEGREES if degree is None else (degree,), accuracy)
        return proofs.result(antialiasing)


def _checked(
    plant: Any, K: Any, n_meas: int | None, n_con: int | None, delay: float
) -> tuple[GeneralizedPlant, StateSpaceModel]:
    k = as_model(getattr(K, "K", K), f"{WHERE}: K")
    given = plant.plant if isinstance(plant, TrackingProblem) else plant
    p = as_generalized_plant(given, n_meas or k.n_inputs, n_con or k.n_outputs, WHERE)
    check_sampling(p, k.dt, delay, WHERE)
    if (k.n_outputs, k.n_inputs) != (p.n_con, p.n_meas):
        raise InputError(WHERE, f"K is {k.n_outputs} x {k.n_inputs}", f"{p.n_con} x {p.n_meas}")
    channels = p.model.n_inputs - p.n_con, p.model.n_outputs - p.n_meas
    needed = sum(b.rows for b in p.blocks), sum(b.cols for b in p.blocks)
    if channels[0] < needed[0] or channels[1] < needed[1]:
        raise InputError(WHERE, f"{channels[0]} and {channels[1]} channels beside u and y", f"at least {needed}")
    taken = [b.name for b in p.blocks if b.name == PERFORMANCE or b.name.startswith(REST)]
    if taken:
        raise InputError(WHERE, f"a block is called {taken[0]!r}", "another name for it")
    return p, StateSpaceModel(k.A, k.B, k.C, k.D, k.dt)


def _inverse(value: float) -> float:
    return 1 / value if value > 0 else float("inf")


class _Proofs:
    """The loop over a period with polynomials of growing degree, and what was proved of it."""

    def __init__(
        self,
        plant: GeneralizedPlant,
        K: StateSpaceModel,
        delay: float,
        until: float,
        seed: int,
        progress: Callable[[str], None] | None,
    ) -> None:
        self.plant, self.K, self.delay, self.until, self.seed = plant, K, delay, until, seed
        self.progress = progress or (lambda _: None)
        self.history: list[tuple[int, float]] = []
        self.best: tuple[Any, UncertainModel, Margin] | None = None

    def refine(self, degrees: tuple[int, ...], accuracy: float) -> None:
        """Prove with one degree after another, as long as it brings something and there is time."""
        begun = time.monotonic()
        for degree in degrees:
            took, begun = time.monotonic() - begun, time.monotonic()
            if self.best is not None and begun + 2 * took > self.until:
                return
            sampled = sample_uncertain_plant(self.plant, self.K.dt, degree, self.delay)
            loop = sampled.uncertain.close(self.K)
            margin = self._margin(loop)
            mu = _inverse(margin.lower)
            self.history.append((degree, mu))
            self.progress(f"degree {degree}: mu at most {mu:.6g}")
            before = np.inf if self.best is None else _inverse(self.best[2].lower)
            if self.best is None or mu < before:
                self.best = sampled, loop, margin
            if np.isfinite(before) and mu > before * (1 - accuracy):
                return

    def _margin(self, loop: UncertainModel) -> Margin:
        """The margin that is asked for: of performance, where there are channels for it."""
        stable = loop.M.is_stable() or not loop.M.n_states
        if not stable:
            radius = float(np.abs(loop.M.poles()).max())
            raise NoTrustworthyNumber(
                WHERE, f"the nominal sampled loop is not stable (a pole of modulus {radius:.6g})",
                "a controller that stabilises the sampled plant", "a shorter sample time, or discretise_controller",
            )  # fmt: skip
        options: dict[str, Any] = {"accuracy": PROOF, "tolerance": np.inf, "seed": self.seed}
        options["time_limit"] = max(self.until - time.monotonic(), 1.0)
        has_performance = len(loop.inputs) and len(loop.outputs)
        return robust_performance(loop, **options) if has_performance else robust_stability(loop, **options)

    def result(self, antialiasing: float | None) -> SampledRobustness:
        """What is known in the end, with the member that comes closest."""
        assert self.best is not None
        sampled, loop, margin = self.best
        performance = margin if len(loop.inputs) and len(loop.outputs) else None
        left = max(self.until - time.monotonic(), 1.0)
        stability = margin
        if performance is not None:
            stability = robust_stability(loop, accuracy=PROOF, tolerance=np.inf, time_limit=left, seed=self.seed)
        mu_lower, member, gain = self._attained(margin, performance is not None)
        if mu_lower > _inverse(margin.lower) * (1 + MEMBER):
            found = f"a member attains mu = {mu_lower:.6g} above the proved {_inverse(margin.lower):.6g}"
            raise NoTrustworthyNumber(WHERE, f"{found}: digits were lost")
        statuses = (margin.status, stability.status)
        notes = []
        if sampled.widened:
            notes.append(f"covered by full blocks: {', '.join(sampled.widened)}")
        if any(not isinstance(b, RealScalar) for b in self.plant.blocks):
            notes.append("dynamic blocks are covered by every linear operator that repeats with the sample time")
        return SampledRobustness(
            stability=stability,
            performance=performance,
            mu_lower=min(mu_lower, _inverse(margin.lower)),
            member=member,
            member_gain=gain,
            loop=loop,
            degree=sampled.degree,
            history=tuple(self.history),
            dt=self.K.dt,
            delay=self.delay,
            antialiasing=antialiasing,
            held=sampled.held,
            widened=sampled.widened,
            status=Status.CERTIFIED if all(s is Status.CERTIFIED for s in statuses) else Status.TIMEOUT,
            notes=tuple(notes),
        )

    def _attained(self, margin: Margin, performance: bool) -> tuple[float, dict[str, float], float]:
        """The largest ``min(1 / size, gain)`` on the way through the critical real parameters."""
        real = {b.name: float(margin.delta.get(b.name, 0.0)) for b in self.plant.blocks if isinstance(b, RealScalar)}
        size = max((abs(v) for v in real.values()), default=0.0)
        direction = {name: value / size for name, value in real.items()} if size > 0 else real
        best = 0.0, dict[str, float](), 0.0
        low, high, at = 0.0, np.inf, size
        for _ in range(SIZES if size > 0 else 1):
            delta = {name: at * value for name, value in direction.items()}
            gain = self._gain(delta, performance)
            attained = min(_inverse(at), gain)
            if attained > best[0]:
                best = attained, delta, gain
            if size == 0 or not performance:
                break
            low, high = (at, high) if gain < _inverse(at) else (low, at)
            wanted = np.sqrt(at / gain) if 0 < gain < np.inf else 0.5 * at
            following = float(wanted if low < wanted < high else np.sqrt(low * high) if low > 0 else 0.5 * high)
            if abs(following - at) <= 1e-3 * at or not np.isfinite(following):
                break
            at = following
        return best

    def _gain(self, delta: Mapping[str, float], performance: bool) -> float:
        """Lower bound of the sampled-data norm of a member; inf where it is not stable, 0 where it is ill-posed."""
        given = self.plant
        try:
            member = UncertainModel(given.model, given.blocks).evaluate(delta)
            norm = sampled_loop_norm(GeneralizedPlant(member, given.n_meas, given.n_con), self.K, self.delay, MEMBER)
        except (InputError, NoTrustworthyNumber):
            return 0.0
        return norm.lower if performance or not np.isfinite(norm.lower) else 0.0
