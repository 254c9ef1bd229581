"""Mixed H2/H-infinity synthesis: the smallest H2 norm of one channel with the H-infinity norm of another bounded."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import Budget, dense, one_thread
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, told_as
from robustlab.norms import H2Norm, HinfNorm, h2_by_gramians, hinf_norm
from robustlab.result import Status
from robustlab.shown import Facts
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.synthesis.h2.common_lyapunov import CommonLyapunov, solver_work
from robustlab.synthesis.h2.h2_synthesis import cancelled_direct_term, cancelling_gain, synthesize_h2
from robustlab.synthesis.h2.tuning import TUNING, H2Tuning
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.problem.design import Synthesis, design_budget, limiting_channels, told
from robustlab.synthesis.problem.independent_check import first_confirmed, norm_doubt
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices, Realisation, as_generalized_plant
from robustlab.synthesis.problem.rebuilt_loop import rebuilt_loop
from robustlab.synthesis.problem.scaling import Scaling, equilibrated, paths_first

__all__ = ["MixedSynthesis", "h2_hinf"]

Names = Sequence[str]


@dataclass(frozen=True, eq=False, kw_only=True)
class MixedSynthesis(Synthesis):
    """A mixed H2/H-infinity design; ``gamma`` is the verified H2 norm of its channel.

    Attributes
    ----------
    h2_norm, hinf_norm
        Norms of the two channels of the rebuilt loop.
    bound
        What the H-infinity norm was to stay below; ``hinf_norm.upper <= bound``.
    h2_optimum
        The H2 norm without the bound: no controller goes below it where it is the optimum of a regular plant.
    hinf_smallest
        The smallest H-infinity norm found for its channel alone.
    h2_plant, hinf_plant
        The plant with one channel each, for `robustlab.verify`.
    """

    quantities: ClassVar[Mapping[str, Any]] = {
        **Synthesis.quantities, **dict.fromkeys(("bound", "h2_optimum", "hinf_smallest"), float),
    }  # fmt: skip

    h2_norm: H2Norm
    hinf_norm: HinfNorm
    bound: float
    h2_optimum: float
    hinf_smallest: float
    h2_plant: GeneralizedPlant
    hinf_plant: GeneralizedPlant

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (H2 norm, verified by both Gramians)"

    def facts(self) -> Facts:
        """What a person wants to read, as (label, text)."""
        rows = super().facts()
        norm = f"{self.hinf_norm.upper:.6g} <= {self.bound:.6g} (smallest found {self.hinf_smallest:.6g})"
        return [
            *rows[:2],
            ("H-infinity norm", norm),
            ("H2 norm without the bound", f"{self.h2_optimum:.6g}"),
            *rows[2:],
        ]

    def to_json(self) -> dict[str, Any]:
        """Everything but the plant, with arrays."""
        return super().to_json() | {
            "h2_norm": self.h2_norm.to_json(),
            "hinf_norm": self.hinf_norm.to_json(),
            "bound": self.bound,
            "h2_optimum": self.h2_optimum,
            "hinf_smallest": self.hinf_smallest,
        }


@told_as("synth h2-hinf")
def h2_hinf(
    P: Any,
    n_meas: int | None = None,
    n_con: int | None = None,
    *,
    gamma: float,
    h2_outputs: Names,
    h2_inputs: Names | None = None,
    hinf_outputs: Names | None = None,
    hinf_inputs: Names | None = None,
    time_limit: float | None = None,
    effort: float = 1.0,
    progress: Callable[[str], None] | None = None,
) -> MixedSynthesis:
    r"""Controller with a small H2 norm of one channel, and the H-infinity norm of another at most ``gamma``.

    .. math:: \min_K \|T_{z_2 w_2}\|_2 \quad\text{subject to}\quad \|T_{z_\infty w_\infty}\|_\infty \le \gamma

    ``u = K y`` with positive feedback. Where the H2 optimum keeps the bound, it is the answer. Otherwise linear matrix
    inequalities with a common Lyapunov matrix (Scherer, Gahinet, Chilali), which alone would be conservative: they are
    solved for larger and larger levels as long as the *true* H-infinity norm of the rebuilt loop stays below gamma. H2
    designs with a weight on the H-infinity channel stand in where P is too large for the inequalities (more than about
    20 states with the usual work). K has the order of P.

    Parameters
    ----------
    P, n_meas, n_con
        Generalised plant as for `robustlab.hinf`.
    gamma
        Bound of the H-infinity norm.
    h2_outputs, h2_inputs
        Names of the performance outputs and disturbances of the H2 channel; all disturbances where left out.
    hinf_outputs, hinf_inputs
        The same for the H-infinity channel; where left out, the other performance outputs, and all disturbances.
    time_limit
        Time in s of the whole search; none where left out. Where it ends the search the status is TIMEOUT.
    effort
        Multiple of the usual work.
    progress
        Called with one line per step.

    Returns
    -------
    MixedSynthesis
        Always with a verified K that keeps the bound. CONVERGED: it is not proved to be the best one.

    Raises
    ------
    InputError
        Unknown names, an empty channel, a bound that is no positive number.
    NoTrustworthyNumber
        No controller with the H-infinity norm below gamma was found (the smallest norm found is named), no
        stabilising controller exists, or the H2 norm is infinite for every controller.

    References
    ----------
    Scherer, Gahinet, Chilali 1997, IEEE TAC 42(7), section IV; Bernstein, Haddad 1989.

    Examples
    --------
    >>> from robustlab.statespace import StateSpaceModel
    >>> P = StateSpaceModel([[0.0]], [[1.0, 0.0, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    ...     inputs=["d", "n", "u"], outputs=["x", "effort", "y"])
    >>> design = h2_hinf(P, 1, 1, gamma=1.45, h2_outputs=["x", "effort"], hinf_outputs=["x", "effort"])
    >>> design.hinf_norm.upper <= 1.45, design.gamma >= design.h2_optimum
    (True, True)
    """
    where = "synth h2-hinf"
    plant = as_generalized_plant(P, n_meas, n_con, where)
    if isinstance(gamma, bool) or not np.isfinite(gamma) or gamma <= 0:
        raise InputError(where, f"gamma is {gamma}", "a positive number")
    budget = design_budget(where, TUNING.work, effort, time_limit)
    channels = _channels(plant, h2_outputs, h2_inputs, hinf_outputs, hinf_inputs)
    with one_thread():
        return _Mixed(plant, *channels, gamma, budget, progress or (lambda _: None), TUNING).result()


@dataclass(frozen=True, eq=False)
class _Channel:
    """Rows of z and columns of w."""

    z: list[int]
    w: list[int]

    def of_loop(self, m: StateSpaceModel) -> StateSpaceModel:
        """The channel of a model from w to z."""
        return _selected(m, self.z, self.w)

    def of_plant(self, plant: GeneralizedPlant) -> GeneralizedPlant:
        """The plant with this channel only."""
        m = plant.model
        rows, columns = [*self.z, *range(plant.n_z, m.n_outputs)], [*self.w, *range(plant.n_w, m.n_inputs)]
        return GeneralizedPlant(_selected(m, rows, columns), plant.n_meas, plant.n_con)

    def of_matrices(self, p: PlantMatrices) -> PlantMatrices:
        """The same of its matrices."""
        z, w = self.z, self.w
        return replace(p, B1=p.B1[:, w], C1=p.C1[z], D11=p.D11[np.ix_(z, w)], D12=p.D12[z], D21=p.D21[:, w])


def _selected(m: StateSpaceModel, rows: list[int], columns: list[int]) -> StateSpaceModel:
    outputs: list[Signal] = [m.outputs[i] for i in rows]
    inputs: list[Signal] = [m.inputs[i] for i in columns]
    return StateSpaceModel(m.A, m.B[:, columns], m.C[rows], m.D[np.ix_(rows, columns)], m.dt, inputs, outputs, m.states)


@dataclass(frozen=True, eq=False)
class _Verified:
    """A controller that keeps the bound."""

    K: StateSpaceModel
    loop: StateSpaceModel
    noisy: StateSpaceModel  # the loop's H2 channel
    h2: H2Norm
    hinf: HinfNorm
    how: str


class _Mixed:
    """One search; every controller that is considered was verified on the plant as given."""

    def __init__(
        self,
        plant: GeneralizedPlant,
        h2: _Channel,
        hinf: _Channel,
        gamma: float,
        budget: Budget,
        say: Callable[[str], None],
        tuning: H2Tuning,
    ) -> None:
        self.plant, self.h2, self.hinf, self.gamma = plant, h2, hinf, gamma
        self.budget, self.say, self.tuning, self.skipped = budget, say, tuning, ""
        self.found: list[_Verified] = []
        self.h2_alone, self.hinf_alone = h2.of_plant(plant), hinf.of_plant(plant)

    def result(self) -> MixedSynthesis:
        where = "synth h2-hinf"
        free = synthesize_h2(self.h2_alone, "h2", self.tuning.kept_finite, self.budget)
        norms = self._judge(free.K, "the H2 optimum, which keeps the bound")
        self.say(f"H2 norm without the bound {free.gamma:.6g}")
        smallest = float("nan")
        optimal = norms is not None and norms[1].upper <= self.gamma
        if not optimal:
            self._weighted_h2()
            smallest = self._robust()
            if not self.found and smallest > self.gamma:
                names = ", ".join(self.plant.model.output_names[i] for i in self.hinf.z)
                raise NoTrustworthyNumber(
                    where,
                    f"no controller keeps the H-infinity norm of {names} below {self.gamma:g}",
                    f"gamma above {smallest:.6g}, the smallest norm found",
                )
            self._search()
        if not self.found:
            raise NoTrustworthyNumber(
                where,
                "no controller that keeps the bound was verified with a finite H2 norm",
                hint=f"a gamma clearly above {smallest:.6g} leaves more room",
            )
        best_first = sorted(self.found, key=lambda v: v.h2.value)[: self.tuning.heard]
        return self._finished(*first_confirmed(best_first, self._heard), free.gamma, smallest, optimal)

    def _heard(self, verified: _Verified) -> tuple[float, str]:
        """What the second voice says of both channels: the H2 norm, and why it is not verified."""
        gamma, doubt = norm_doubt(self.h2_alone, verified.K, verified.noisy, verified.h2)
        if not doubt:
            _, doubt = norm_doubt(self.hinf_alone, verified.K, self.hinf.of_loop(verified.loop), verified.hinf)
        return gamma, doubt

    def _robust(self) -> float:
        """The smallest H-infinity norm found; where nothing keeps the bound yet, its designs are candidates."""
        try:
            robust = synthesize(self.hinf_alone, "hinf", 1.0, self.budget.share(0.4))
            smallest = robust.smallest_gamma
            self.say(f"smallest H-infinity norm found {smallest:.6g}")
            self._judge(robust.K, "the H-infinity design")
            if smallest and len(self.found) <= 1 and self.gamma > self.tuning.room * smallest and not self.budget.over:
                # The softest one that keeps the bound has a smaller H2 norm than the tightest.
                share = self.budget.share(0.4)
                soft = synthesize(self.hinf_alone, "hinf", 0.999 * self.gamma / smallest, share)
                self._judge(soft.K, "the softest H-infinity design found that keeps the bound")
            return smallest
        except NoTrustworthyNumber:
            if not self.found:
                raise
            return float("nan")

    def _judge(self, K: StateSpaceModel, how: str, D22: AnyArray | None = None) -> tuple[H2Norm, HinfNorm] | None:
        """Norms of both channels of the rebuilt loop; K is kept where they are sound and the bound holds."""
        nothing = np.zeros_like(self.plant.D22)
        self.budget.spend(dense(self.plant.model.n_states + K.n_states, 11))  # both norms
        rebuilt = rebuilt_loop(self.plant, K, nothing if D22 is None else D22)
        if rebuilt is None:
            return None
        named, loop = rebuilt
        noisy = self.h2.of_loop(loop)
        if not loop.is_discrete:
            cleared = cancelled_direct_term(noisy, self.h2_alone.matrices().D11, K.D)
            if cleared is None:
                return None
            noisy = cleared
        h2_found, hinf_found = h2_by_gramians(noisy), hinf_norm(self.hinf.of_loop(loop))
        sound = h2_found.status.trustworthy and hinf_found.status.trustworthy and np.isfinite(h2_found.value)
        if sound and hinf_found.upper <= self.gamma:
            self.found.append(_Verified(named, loop, noisy, h2_found, hinf_found, how))
        return (h2_found, hinf_found) if sound else None

    def _weighted_h2(self) -> None:
        """H2 designs in which the H-infinity channel carries more and more weight, up to the first that keeps the
        bound: a quick start that works at any size.
        """
        m, n_z, n_w = self.plant.model, self.plant.n_z, self.plant.n_w
        first, last = self.tuning.weight_steps
        for weight in (float(x) for x in 10 ** (np.arange(first, last + 1) / 4)):
            if self.budget.over:
                return
            rows, columns = np.ones(m.n_outputs), np.ones(m.n_inputs)
            rows[:n_z], columns[:n_w] = 0.0, 0.0
            rows[self.hinf.z], columns[self.hinf.w] = weight, 1.0
            rows[self.h2.z], columns[self.h2.w] = np.maximum(rows[self.h2.z], 1.0), 1.0
            D = rows[:, None] * m.D * columns
            D[:n_z, :n_w] = 0.0  # only a design is looked for; what it is worth is judged on the plant
            shaped = StateSpaceModel(m.A, m.B * columns, rows[:, None] * m.C, D, m.dt, m.inputs, m.outputs, m.states)
            try:
                shaped_plant = GeneralizedPlant(shaped, self.plant.n_meas, self.plant.n_con)
                design = synthesize_h2(shaped_plant, "h2", self.tuning.kept_finite, self.budget)
            except NoTrustworthyNumber:
                continue
            norms = self._judge(design.K, f"an H2 design with weight {weight:.3g} on the H-infinity channel")
            if norms is not None and norms[1].upper <= self.gamma:
                self.say(f"weight {weight:.3g}: H2 {norms[0].value:.6g}, H-inf {norms[1].upper:.6g}")
                return

    def _search(self) -> None:
        matrices, dt = self.plant.matrices(), self.plant.model.dt
        gain = cancelling_gain(self.h2.of_matrices(matrices), dt, "synth h2-hinf")
        channels = [len(channel.z) + len(channel.w) for channel in (self.h2, self.hinf)]
        setup, step = solver_work(len(matrices.A), *channels)
        if setup + 3 * step > self.budget.left:
            self.skipped = "the linear matrix inequalities were too large for the work left: a larger effort tries them"
            self.say(self.skipped)
            return
        for scale in (equilibrated, paths_first):
            scaling = scale(matrices)
            if dt:
                scaling = scaling.in_steps()
            p = scaling.apply(matrices)
            gain_scaled = gain / scaling.u[:, None] / scaling.y
            h2, hinf = self.h2.of_matrices(p), self.hinf.of_matrices(p)
            problem = CommonLyapunov(h2, hinf, gain_scaled, self.budget, discrete=bool(dt), tuning=self.tuning)

            def attempt(
                level: float, share: float, problem: CommonLyapunov = problem, scaling: Scaling = scaling
            ) -> bool:
                bare = problem.controller(level * self.gamma * scaling.gain, share)
                return bare is not None and self._attempted(bare, scaling, f"level {level:.3g} gamma, share {share:g}")

            if self._push(attempt):
                return

    def _attempted(self, bare: StateSpaceModel, scaling: Scaling, how: str) -> bool:
        """Whether the true norm of this controller for the scaled plant keeps the bound."""
        try:
            K = StateSpaceModel(*scaling.controller_to_plant(Realisation.of(bare)), self.plant.model.dt)
        except InputError:  # entries overflow when scaled back
            return False
        norms = self._judge(K, f"linear matrix inequalities at {how}", self.plant.D22)
        text = "no verified loop" if norms is None else f"H2 {norms[0].value:.6g}, H-inf {norms[1].upper:.6g}"
        self.say(f"{how}: {text}")
        return norms is not None and norms[1].upper <= self.gamma

    def _push(self, attempt: Callable[[float, float], bool]) -> bool:
        """Largest level whose controller keeps the bound, by growing steps and bisection; then the best share.

        The H2 norm falls as the level grows, so the last controller that keeps the bound is the best one. False where
        no level gives a controller.
        """
        levels, lower = self.tuning.levels, self.tuning.lower_levels
        low, high = 0.0, levels[-1]
        for level in levels:
            if self.budget.over or not attempt(level, 1.0):
                high = level
                break
            low = level
        if low == 0.0:
            low = next((level for level in lower if not self.budget.over and attempt(level, 1.0)), 0.0)
        if low == 0.0:
            return False
        for _ in range(self.tuning.refinements):
            middle = 0.5 * (low + high)
            if high == low or self.budget.over:
                break
            low, high = (middle, high) if attempt(middle, 1.0) else (low, middle)
        for factor in self.tuning.split_factors:
            share = factor
            while not self.budget.over and 1e-4 < share < 1e4:
                before = min(v.h2.value for v in self.found)
                # Another share moves the level that the true norm allows: a larger one is tried as well.
                if attempt(low, share) and attempt(1.1 * low, share):
                    low *= 1.1
                if min(v.h2.value for v in self.found) > before * (1 - self.tuning.split_gain):
                    break
                share *= factor
        return True

    def _finished(
        self, best: _Verified, gamma: float, doubt: str, h2_optimum: float, smallest: float, optimal: bool
    ) -> MixedSynthesis:
        parts = [doubt or "loop rebuilt from K is stable; both norms were verified", best.how]
        if not optimal:
            parts.append("a better controller may exist")
        parts += [self.skipped] if self.skipped else []
        sound = Status.INACCURATE if doubt else Status.CONVERGED
        status, reason = told(sound, parts, self.budget, "a better controller")
        bound = f"H-infinity norm {best.hinf.upper:.4g} of {self.gamma:.4g} allowed"
        peak = limiting_channels(self.hinf.of_loop(best.loop), best.hinf.frequency)
        return MixedSynthesis(
            K=best.K,
            gamma=gamma,
            closed_loop=best.loop,
            status=status,
            reason=reason,
            limit=f"{bound}; {peak}" if peak else bound,
            plant=self.plant,
            method="h2-hinf",
            h2_norm=best.h2,
            hinf_norm=best.hinf,
            bound=self.gamma,
            h2_optimum=h2_optimum,
            hinf_smallest=smallest,
            h2_plant=self.h2_alone,
            hinf_plant=self.hinf_alone,
        )


# --- channels ---------------------------------------------------------------------------------------------------------


def _channels(
    plant: GeneralizedPlant, h2_outputs: Names, h2_inputs: Names | None, outputs: Names | None, inputs: Names | None
) -> tuple[_Channel, _Channel]:
    zs, ws = plant.model.output_names[: plant.n_z], plant.model.input_names[: plant.n_w]
    z2 = _positions(h2_outputs, zs, "h2_outputs")
    w2 = list(range(len(ws))) if h2_inputs is None else _positions(h2_inputs, ws, "h2_inputs")
    others = [i for i in range(len(zs)) if i not in z2]
    z = others if outputs is None else _positions(outputs, zs, "hinf_outputs")
    w = list(range(len(ws))) if inputs is None else _positions(inputs, ws, "hinf_inputs")
    for name, found in (("h2_outputs", z2), ("h2_inputs", w2), ("hinf_outputs", z), ("hinf_inputs", w)):
        if not found:
            raise InputError("synth h2-hinf", f"{name} is empty", "at least one channel", "name it by signal names")
    return _Channel(z2, w2), _Channel(z, w)


def _positions(names: Names, known: Sequence[str], what: str) -> list[int]:
    names = [names] if isinstance(names, str) else list(names)
    for name in names:
        if name not in known:
            hint = did_you_mean(name, tuple(known))
            raise InputError(f"synth h2-hinf: {what}", f"no signal {name!r}", f"one of {', '.join(known)}", hint)
    return [list(known).index(name) for name in names]
