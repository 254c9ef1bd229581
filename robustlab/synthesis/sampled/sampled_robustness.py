"""Robust stability and robust performance of an uncertain continuous plant under a digital controller, proved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.budget import Budget, dense, one_thread
from robustlab.errors import InputError, NoTrustworthyNumber, told_as
from robustlab.mu_analysis.axis.margin import Margin
from robustlab.mu_analysis.axis.stability import margin_within
from robustlab.mu_analysis.axis.worst_gain import PERFORMANCE, with_performance
from robustlab.mu_analysis.matrix.upper import compile_kernels
from robustlab.result import Status
from robustlab.shown import Facts, Shown
from robustlab.statespace import StateSpaceModel, lower_lft
from robustlab.synthesis.problem.design import design_budget
from robustlab.synthesis.problem.partition import GeneralizedPlant
from robustlab.synthesis.sampled.lifting import lift
from robustlab.synthesis.sampled.sampled_controller import SampledController
from robustlab.synthesis.sampled.sampled_norm import (
    norm_work,
    plant_and_controller,
    sampled_loop_norm,
    with_antialiasing,
)
from robustlab.synthesis.sampled.sampled_uncertainty import REST, SampledUncertainPlant, sample_uncertain_plant
from robustlab.synthesis.sampled.tuning import TUNING, SampledTuning
from robustlab.synthesis.specifications.tracking_problem import TrackingProblem
from robustlab.uncertainty.blocks import block_slices
from robustlab.uncertainty.lft import UncertainModel

WHERE = "sampled_robustness"
# A member may attain more than was proved by rounding, and no more.
AGREE = 1e-5


@dataclass(frozen=True, eq=False)
class SampledRobustness(Shown):
    r"""Robustness of a sampled loop; the bounds hold for the continuous signals, between the samples too.

    Attributes
    ----------
    stability
        Margin of robust stability: the loop is stable for every Delta of norm below ``stability.lower``; the member at
        ``stability.delta``, of size ``stability.upper``, is not (inf: none was found).
    performance
        Margin of robust performance: for every Delta of norm below k = ``performance.lower`` the gain from disturbances
        to performance is below 1 / k; ``performance.delta`` is the member that attains ``mu_lower`` (dynamic blocks are
        zero in it). None where the plant has no such channels.
    mu_lower
        Attained by a member of the set in its own exact sampled loop: ``min(1 / size, gain)`` of the one at ``member``.
    member_gain
        Lower bound of the sampled-data norm of that member; inf where it is not stable.
    loop, stability_loop
        The uncertain discrete loops that were proved: ``rl.robust_performance(loop)`` proves it again. Their blocks are
        those of the plant on the signals of a period, and a cover called ``"rest of the real blocks"``.
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
        CERTIFIED: the margins are proved. TIMEOUT: the time limit ended a proof. INCONCLUSIVE: the work was done before
        something was proved; ``mu_upper`` is inf then.
    notes
        What a reader must know.
    """

    stability: Margin
    performance: Margin | None
    mu_lower: float
    member_gain: float
    loop: UncertainModel
    stability_loop: UncertainModel
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
    def member(self) -> Mapping[str, float]:
        """The Delta of real parameters that attains ``mu_lower``; empty where none was found, or there is none."""
        return (self.performance or self.stability).delta

    @property
    def mu_upper(self) -> float:
        """``1 / margin``: proved upper bound of mu; inf where nothing is proved."""
        return _inverse(self.margin)

    def facts(self) -> Facts:
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
        """All attributes but the loops, the margin, and mu from above."""
        names = [name for name in self.__dataclass_fields__ if not name.endswith("loop")]
        data = {name: getattr(self, name) for name in names}
        return {"type": "SampledRobustness", **data, "margin": self.margin, "mu_upper": self.mu_upper}


@dataclass(frozen=True, eq=False, kw_only=True)
class RobustSampledController(SampledController):
    """A digital controller of an uncertain plant, with robust performance proved before and after.

    Attributes
    ----------
    before
        Margin of robust performance of the continuous loop.
    after
        Robustness of the sampled loop; it holds for every member of the continuous set with its own exact
        discretisation, and for the signals between the samples.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        **SampledController.quantities,
        **{key: {"lower": "1", "upper": "1"} for key in ("mu_before", "mu_after")},
        **dict.fromkeys(("margin_before", "margin_after", "stability_margin_after", "mu_growth"), "1"),
    }

    before: Margin
    after: SampledRobustness

    @property
    def mu_before(self) -> dict[str, float]:
        """Bounds of mu of robust performance of the continuous loop."""
        return {"lower": _inverse(self.before.upper), "upper": _inverse(self.before.lower)}

    @property
    def mu_after(self) -> dict[str, float]:
        """The same of the sampled loop."""
        return {"lower": self.after.mu_lower, "upper": self.after.mu_upper}

    @property
    def margin_before(self) -> float:
        """Proved margin of the continuous loop."""
        return self.before.lower

    @property
    def margin_after(self) -> float:
        """Proved margin of the sampled loop."""
        return self.after.margin

    @property
    def stability_margin_after(self) -> float:
        """Proved margin of the sampled loop's stability."""
        return self.after.stability.lower

    @property
    def mu_growth(self) -> float:
        """By which share sampling makes the bound of mu larger."""
        before = self.mu_before["upper"]
        return self.after.mu_upper / before - 1 if before > 0 else 0.0

    def headline(self) -> str:
        """What sampling costs."""
        before, after = self.mu_before["upper"], self.after.mu_upper
        kept = self.stability_margin_after
        part = "" if kept >= 1 else f"; STABILITY of the sampled loop is proved for {kept:.3g} of the set only"
        return f"{super().headline()}; mu of robust performance: {before:.4g} before, {after:.4g} sampled{part}"

    def facts(self) -> Facts:
        """Those of the controller, and mu before and after."""
        mu = self.mu_before
        before = f"{mu['lower']:.4g} .. {mu['upper']:.4g} (attained .. proved)"
        sampled = [(f"sampled: {label}", text) for label, text in self.after.facts()]
        return [*super().facts(), ("mu of robust performance, continuous", before), *sampled]

    def to_json(self) -> dict[str, Any]:
        """That of the controller, with the robustness of the sampled loop and the margin of the continuous one."""
        return super().to_json() | {"robustness": self.after.to_json(), "margin_before": self.margin_before}


@told_as("sampled_robustness")
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
    time_limit: float | None = None,
    effort: float = 1.0,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    tuning: SampledTuning = TUNING,
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
        Number of polynomials; where left out the first of 1 to 5 whose cover is tight enough for the sample time (known
        before any proof), and the next one where mu is not yet within ``accuracy`` of what is attained.
    accuracy
        Relative distance or change of mu that ends the refinement.
    time_limit
        Time in s for all proofs; none where left out. Where it ends one the status is TIMEOUT.
    effort
        Multiple of the usual work.
    seed
        Seed of the searches.
    progress
        Called with one line for each degree.
    tuning
        Numbers that choose speed and accuracy, for those who measure them.

    Returns
    -------
    SampledRobustness
        The proved margins, the member that attains most, and the loops that were proved.

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
    >>> from robustlab.uncertainty.blocks import RealScalar
    >>> M = StateSpaceModel([[-1.0]], [[-0.3, 1.0, 1.0]], [[1.0]] * 3, [[0.0] * 3] * 3)
    >>> K = StateSpaceModel([], [], [], [[-3.0]], 0.05)
    >>> robust = sampled_robustness(UncertainModel(M, [RealScalar("pole")]), K)
    >>> robust.status.value, robust.mu_lower <= robust.mu_upper <= 1.01 * robust.mu_lower
    ('certified', True)
    """
    p, k = _checked(plant, K, n_meas, n_con, delay)
    if degree is not None and (isinstance(degree, bool) or not isinstance(degree, int) or not 1 <= degree <= 6):
        raise InputError(WHERE, f"degree is {degree!r}", "a whole number from 1 to 6")
    if not 0 < accuracy < 1:
        raise InputError(WHERE, f"accuracy {accuracy}", "a number between 0 and 1")
    budget = design_budget(WHERE, tuning.robustness_work, effort, time_limit)
    filtered = with_antialiasing(p, antialiasing, WHERE)
    with one_thread():
        compile_kernels()
        proofs = _Proofs(filtered, k, float(delay), budget, seed, progress, tuning)
        return proofs.run(tuning.degrees if degree is None else (degree,), accuracy, antialiasing)


def _checked(
    plant: Any, K: Any, n_meas: int | None, n_con: int | None, delay: float
) -> tuple[GeneralizedPlant, StateSpaceModel]:
    given = plant.plant if isinstance(plant, TrackingProblem) else plant
    p, k = plant_and_controller(given, K, n_meas, n_con, delay, WHERE)
    channels = p.model.n_inputs - p.n_con, p.model.n_outputs - p.n_meas
    needed = sum(b.rows for b in p.blocks), sum(b.cols for b in p.blocks)
    if channels[0] < needed[0] or channels[1] < needed[1]:
        raise InputError(WHERE, f"{channels[0]} and {channels[1]} channels beside u and y", f"at least {needed}")
    taken = [b.name for b in p.blocks if b.name in (PERFORMANCE, REST)]
    if taken:
        raise InputError(WHERE, f"a block is called {taken[0]!r}", "another name for it")
    return p, k


def _inverse(value: float) -> float:
    return 1 / value if value > 0 else float("inf")


@dataclass(frozen=True)
class _Aim:
    """Expected margin, and the real parameters of a critical Delta."""

    size: float
    delta: Mapping[str, float]


class _Proofs:
    """The loop over a period with polynomials of growing degree, and what was proved of it."""

    def __init__(
        self,
        plant: GeneralizedPlant,
        K: StateSpaceModel,
        delay: float,
        budget: Budget,
        seed: int,
        progress: Callable[[str], None] | None,
        tuning: SampledTuning,
    ) -> None:
        self.tuning = tuning
        self.plant, self.K, self.delay, self.budget, self.seed = plant, K, delay, budget, seed
        self.progress = progress or (lambda _: None)
        self.real = [b.name for b in plant.blocks if b.interval]
        self.history: list[tuple[int, float]] = []

    def run(self, degrees: tuple[int, ...], accuracy: float, antialiasing: float | None) -> SampledRobustness:
        """Prove with one degree after another, as long as it brings something and there is work left."""
        first = sample_uncertain_plant(self.plant, self.K.dt, degrees[0], self.delay)
        loop = first.uncertain.close(self.K)
        _check_stable(loop)
        core = _without_rests(loop)
        performance = len(loop.inputs) > 0 and len(loop.outputs) > 0
        aim = self._aim(core, performance)
        degrees = self._worthwhile(degrees, aim.size)
        proof, sampled, loop, (mu_lower, member, gain) = self._refined(aim, performance, degrees, accuracy)
        shown = self._with_member(proof, mu_lower, member)
        stability, stability_loop = shown, loop
        if performance:
            aim = _Aim(self._sensible(self._proof(core, False, aim.size, self.tuning.search).lower), aim.delta)
            stability_loop = self._loop(sampled.degree, aim.size)[1]
            stable = self._proof(stability_loop, False, aim.size)
            if stable.lower < proof.lower:  # robust performance needs stability: its proof is one of stability
                stable, stability_loop = proof, loop
            stability = self._with_member(stable, *self._unstable_member(aim.delta)[:2])
        notes = [f"covered by full blocks: {', '.join(sampled.widened)}"] if sampled.widened else []
        if len(self.real) < len(self.plant.blocks):
            notes.append("dynamic blocks: every linear operator that repeats with the sample time; zero in the member")
        certified = all(m.status is Status.CERTIFIED for m in (shown, stability))
        status = Status.CERTIFIED if certified else Status.INCONCLUSIVE
        if self.budget.struck:
            status = Status.TIMEOUT
        if self.budget.remark:
            notes.append(self.budget.remark)
        return SampledRobustness(
            stability=stability,
            performance=shown if performance else None,
            mu_lower=mu_lower,
            member_gain=gain,
            loop=loop,
            stability_loop=stability_loop,
            degree=sampled.degree,
            history=tuple(self.history),
            dt=self.K.dt,
            delay=self.delay,
            antialiasing=antialiasing,
            held=sampled.held,
            widened=sampled.widened,
            status=status,
            notes=tuple(notes),
        )

    def _aim(self, core: UncertainModel, performance: bool) -> _Aim:
        """What the loop without covers says: no bound, but an estimate, and where to look for members."""
        if not self.real:
            return _Aim(self._sensible(self._proof(core, performance, 1.0, self.tuning.search).lower), {})
        searched = with_performance(core) if performance else core
        part = self.budget.share(self.tuning.aim_share)
        found = margin_within(searched, part, accuracy=self.tuning.search, tolerance=np.inf, seed=self.seed)
        return _Aim(self._sensible(found.lower), {name: float(found.delta.get(name, 0.0)) for name in self.real})

    def _refined(
        self, aim: _Aim, performance: bool, degrees: tuple[int, ...], accuracy: float
    ) -> tuple[Margin, SampledUncertainPlant, UncertainModel, tuple[float, dict[str, float], float]]:
        """The best proof, its loop, and the member that attains most."""
        member = self._attained(aim.delta) if performance else self._unstable_member(aim.delta)
        enough = max(1 / aim.size, member[0]) * (1 + accuracy)
        best: tuple[Margin, SampledUncertainPlant, UncertainModel] | None = None
        before_that = self.budget.left
        for degree in degrees:
            took, before_that = before_that - self.budget.left, self.budget.left
            if best is not None and (3 * took > self.budget.left or self.budget.over):
                break
            sampled, loop = self._loop(degree, aim.size)
            margin = self._proof(loop, performance, aim.size)
            mu, before = _inverse(margin.lower), np.inf if best is None else _inverse(best[0].lower)
            self.history.append((degree, mu))
            self.progress(f"degree {degree}: mu at most {mu:.6g}")
            if best is None or mu < before:
                best = margin, sampled, loop
            if mu <= enough or (np.isfinite(before) and mu > before * (1 - accuracy)):
                break
        assert best is not None
        return *best, member

    def _worthwhile(self, degrees: tuple[int, ...], size: float) -> tuple[int, ...]:
        """The degrees without those whose cover is too loose or whose loop is too large: known before any proof."""
        small: list[int] = []
        for degree in degrees:
            sampled = sample_uncertain_plant(self.plant, self.K.dt, degree, self.delay, size)
            if small and sampled.uncertain.delta_shape[0] > self.tuning.most_delta:
                break
            if size * sampled.looseness <= self.tuning.loose:
                more = sampled.uncertain.delta_shape[0] * (degree + 1) <= self.tuning.most_delta * degree
                return (degree, degree + 1) if more and degree < degrees[-1] else (degree,)
            small.append(degree)
        return tuple(small[-1:]) or degrees[:1]

    def _loop(self, degree: int, size: float) -> tuple[SampledUncertainPlant, UncertainModel]:
        """The closed loop, with the rests covered best for Delta of that size."""
        sampled = sample_uncertain_plant(self.plant, self.K.dt, degree, self.delay, size)
        return sampled, sampled.uncertain.close(self.K)

    def _proof(self, loop: UncertainModel, performance: bool, size: float, accuracy: float | None = None) -> Margin:
        """The margin from below alone, where about ``size`` is expected."""
        proved = with_performance(loop) if performance else loop
        part, tuning = self.budget.share(self.tuning.proof_share), self.tuning
        accuracy = tuning.proof if accuracy is None else accuracy
        return margin_within(proved, part, accuracy=accuracy, tolerance=np.inf, expected=size * (1 + tuning.search))

    def _with_member(self, margin: Margin, mu: float, member: Mapping[str, float]) -> Margin:
        """The proved margin with the member that attains ``mu``."""
        proved = _inverse(margin.lower)
        if mu > proved * (1 + AGREE):
            found = f"a member attains mu = {mu:.6g} above the proved {proved:.6g}"
            raise NoTrustworthyNumber(WHERE, f"{found}: digits were lost")
        known = UncertainModel(self.plant.model, self.plant.blocks)
        upper = max(_inverse(mu), margin.lower)
        return replace(margin, upper=upper, delta=dict(member), physical=known.physical(member) if member else {})

    def _sensible(self, size: float) -> float:
        """A margin as the size of Delta to prepare for; one where the margin says nothing."""
        return size if 1 / self.tuning.largest < size < self.tuning.largest else 1.0

    # --- members ------------------------------------------------------------------------------------------------------

    def _unstable_member(self, delta: Mapping[str, float]) -> tuple[float, dict[str, float], float]:
        """One over the size of a multiple of Delta whose exact sampled loop is not stable; 0 where none was found."""
        size = max((abs(v) for v in delta.values()), default=0.0)
        if size == 0:
            return 0.0, {}, 0.0
        stable, unstable = 0.0, 0.0
        for factor in self.tuning.multiples:
            if not self._is_stable({name: float(factor) * value for name, value in delta.items()}):
                unstable = float(factor)
                break
            stable = float(factor)
        while unstable - stable > self.tuning.settled * unstable:
            middle = 0.5 * (stable + unstable)
            if self._is_stable({name: middle * value for name, value in delta.items()}):
                stable = middle
            else:
                unstable = middle
        if not unstable:
            return 0.0, {}, 0.0
        return 1 / (unstable * size), {name: unstable * value for name, value in delta.items()}, np.inf

    def _is_stable(self, delta: Mapping[str, float]) -> bool:
        """Whether a member is stable in its own exact sampled loop; True where that cannot be told."""
        self.budget.spend(dense(self.plant.model.n_states + self.K.n_states, 4))
        try:
            lifted = lift(self._member(delta), self.K.dt, 1, self.delay)
            return lower_lft(lifted.model, self.K).is_stable()
        except (InputError, NoTrustworthyNumber):
            return True

    def _member(self, delta: Mapping[str, float]) -> GeneralizedPlant:
        given = self.plant
        member = UncertainModel(given.model, given.blocks).evaluate(delta)
        return GeneralizedPlant(member, given.n_meas, given.n_con)

    def _attained(self, delta: Mapping[str, float]) -> tuple[float, dict[str, float], float]:
        """The largest ``min(1 / size, gain)`` on the way through the critical real parameters."""
        size = max((abs(v) for v in delta.values()), default=0.0)
        if size == 0:
            gain = self._gain({})
            return gain, {}, gain
        direction = {name: value / size for name, value in delta.items()}
        best = 0.0, dict[str, float](), 0.0
        low, high, at = 0.0, np.inf, size
        for _ in range(self.tuning.sizes):
            tried = {name: at * value for name, value in direction.items()}
            gain = self._gain(tried)
            if min(1 / at, gain) > best[0]:
                best = min(1 / at, gain), tried, gain
            low, high = (at, high) if gain < 1 / at else (low, at)
            wanted = float(np.sqrt(at / gain)) if 0 < gain < np.inf else 0.5 * at
            inside = wanted if low < wanted < high else np.sqrt(low * high) if low > 0 else 0.5 * high
            if not np.isfinite(inside) or abs(inside - at) <= self.tuning.settled * at:
                break
            at = float(inside)
        return best

    def _gain(self, delta: Mapping[str, float]) -> float:
        """Lower bound of the sampled-data norm of a member; inf where it is not stable, 0 where it is ill-posed."""
        self.budget.spend(norm_work(self.plant, self.K))
        try:
            return sampled_loop_norm(
                self._member(delta), self.K, self.delay, self.tuning.member, tuning=self.tuning
            ).lower
        except (InputError, NoTrustworthyNumber):
            return 0.0


def _check_stable(loop: UncertainModel) -> None:
    if loop.M.n_states and not loop.M.is_stable():
        radius = float(np.abs(loop.M.poles()).max())
        raise NoTrustworthyNumber(
            WHERE, f"the nominal sampled loop is not stable (a pole of modulus {radius:.6g})",
            "a controller that stabilises the sampled plant", "a shorter sample time, or rl.discretise of the design",
        )  # fmt: skip


def _without_rests(loop: UncertainModel) -> UncertainModel:
    """The loop with the blocks of the plant alone."""
    q, p = loop.delta_shape
    ins, outs, blocks = list[int](), list[int](), []
    for block, (w, z) in zip(loop.blocks, block_slices(loop.blocks), strict=True):
        if block.name != REST:
            ins += range(w.start, w.stop)
            outs += range(z.start, z.stop)
            blocks.append(block)
    ins += range(q, loop.M.n_inputs)
    outs += range(p, loop.M.n_outputs)
    m = loop.M
    return UncertainModel(StateSpaceModel(m.A, m.B[:, ins], m.C[outs], m.D[np.ix_(outs, ins)], m.dt), blocks)
