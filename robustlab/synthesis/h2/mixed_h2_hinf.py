"""Mixed H2/H-infinity synthesis: the smallest H2 norm of one channel with the H-infinity norm of another bounded."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.budget import MILLION, Budget, dense, one_thread
from robustlab.errors import InputError, NoTrustworthyNumber, did_you_mean, told_as
from robustlab.norms import H2Norm, HinfNorm, h2_norm, hinf_norm
from robustlab.result import Status
from robustlab.statespace import Signal, StateSpaceModel
from robustlab.synthesis.h2.common_lyapunov import Channel, CommonLyapunov, solver_work
from robustlab.synthesis.h2.h2_synthesis import cancelled_direct_term, cancelling_gain, synthesize_h2
from robustlab.synthesis.hinf.hinf_synthesis import synthesize
from robustlab.synthesis.problem.design import Synthesis, design_budget, limiting_channels, told
from robustlab.synthesis.problem.independent_check import norm_doubt
from robustlab.synthesis.problem.partition import GeneralizedPlant, PlantMatrices, Realisation, as_generalized_plant
from robustlab.synthesis.problem.rebuilt_loop import rebuilt_loop
from robustlab.synthesis.problem.scaling import Scaling, equilibrated, paths_first

__all__ = ["MixedSynthesis", "h2_hinf"]

Names = Sequence[str]
WORK = 60 * MILLION
H2_REL = 1.0005  # loss of the H2 designs where they have to be kept finite

# Levels of the H-infinity inequality, in shares of gamma: above 1, because the common Lyapunov matrix makes it
# conservative; below 1, because the solver may miss its level by a little.
LEVELS = (1.0, 1.3, 1.7, 2.5, 4.0, 8.0)
LOWER = (0.995, 0.97, 0.9)
REFINEMENTS = 5
# Factors by which the split of the level between w and z is moved, as long as the H2 norm falls by this much.
SHARES = (3.0, 1 / 3)
GAIN = 0.01
ROOM = 1.02
# Controllers, best first, that the second voice is asked about.
HEARD = 6
# Weights of the H-infinity channel in H2 designs.
WEIGHTS = tuple(float(x) for x in 10 ** (np.arange(-4, 13) / 4))


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
    """

    h2_norm: H2Norm
    hinf_norm: HinfNorm
    bound: float
    h2_optimum: float
    hinf_smallest: float

    def _gamma_text(self) -> str:
        return f"{self.gamma:.6g} (H2 norm, verified by both Gramians)"

    def summary(self) -> list[tuple[str, str]]:
        """What a person wants to read, as (label, text)."""
        rows = super().summary()
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
    budget = design_budget(where, WORK, effort, time_limit)
    channels = _channels(plant, h2_outputs, h2_inputs, hinf_outputs, hinf_inputs)
    with one_thread():
        return _Mixed(plant, channels, gamma, budget, progress).result()


@dataclass(frozen=True, eq=False)
class _Pair:
    """Rows of z and columns of w of the two channels."""

    h2: tuple[list[int], list[int]]
    hinf: tuple[list[int], list[int]]


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
        channels: _Pair,
        gamma: float,
        budget: Budget,
        progress: Callable[[str], None] | None,
    ) -> None:
        self.plant, self.channels, self.gamma = plant, channels, gamma
        self.budget, self.skipped = budget, ""
        self.say = progress or (lambda line: None)
        self.found: list[_Verified] = []
        self.alone = {kind: _part(plant, *getattr(channels, kind)) for kind in ("h2", "hinf")}

    def result(self) -> MixedSynthesis:
        where = "synth h2-hinf"
        free = synthesize_h2(self.alone["h2"], "h2", H2_REL, self.budget)
        norms = self._judge(free.K, "the H2 optimum, which keeps the bound")
        self.say(f"H2 norm without the bound {free.gamma:.6g}")
        smallest = float("nan")
        optimal = norms is not None and norms[1].upper <= self.gamma
        if not optimal:
            self._weighted_h2()
            smallest = self._robust()
            if not self.found and smallest > self.gamma:
                raise NoTrustworthyNumber(
                    where,
                    f"no controller keeps the H-infinity norm of {', '.join(self._names('hinf'))} below {self.gamma:g}",
                    f"gamma above {smallest:.6g}, the smallest norm found",
                )
            self._search()
        if not self.found:
            raise NoTrustworthyNumber(
                where,
                "no controller that keeps the bound was verified with a finite H2 norm",
                hint=f"a gamma clearly above {smallest:.6g} leaves more room",
            )
        return self._finished(*self._heard(), free.gamma, smallest, optimal)

    def _heard(self) -> tuple[_Verified, float, str]:
        """The controller of smallest H2 norm that the second voice confirms; or else the one of smallest H2 norm, with
        the larger number and the reason why it is not verified.
        """
        first: tuple[_Verified, float, str] | None = None
        for verified in sorted(self.found, key=lambda v: v.h2.value)[:HEARD]:
            gamma, doubt = norm_doubt(self.alone["h2"], verified.K, verified.noisy, verified.h2)
            if not doubt:
                loop = _selected(verified.loop, *self.channels.hinf)
                _, doubt = norm_doubt(self.alone["hinf"], verified.K, loop, verified.hinf)
            first = first or (verified, gamma, doubt)
            if not doubt:
                return verified, gamma, doubt
        assert first is not None
        return first

    def _robust(self) -> float:
        """The smallest H-infinity norm found; where nothing keeps the bound yet, its designs are candidates."""
        try:
            robust = synthesize(self.alone["hinf"], "hinf", 1.0, self.budget.share(0.4))
            smallest = robust.smallest_gamma
            self.say(f"smallest H-infinity norm found {smallest:.6g}")
            self._judge(robust.K, "the H-infinity design")
            if len(self.found) <= 1 and self.gamma > ROOM * smallest and not self.budget.over:
                # The softest one that keeps the bound has a smaller H2 norm than the tightest.
                share = self.budget.share(0.4)
                soft = synthesize(self.alone["hinf"], "hinf", 0.999 * self.gamma / smallest, share)
                self._judge(soft.K, "the softest H-infinity design found that keeps the bound")
            return smallest
        except NoTrustworthyNumber:
            if not self.found:
                raise
            return float("nan")

    def _names(self, kind: str) -> list[str]:
        rows = getattr(self.channels, kind)[0]
        return [self.plant.model.output_names[i] for i in rows]

    def _judge(self, K: StateSpaceModel, how: str, D22: AnyArray | None = None) -> tuple[H2Norm, HinfNorm] | None:
        """Norms of both channels of the rebuilt loop; K is kept where they are sound and the bound holds."""
        nothing = np.zeros_like(self.plant.D22)
        self.budget.spend(dense(self.plant.model.n_states + K.n_states, 11))  # both norms
        rebuilt = rebuilt_loop(self.plant, K, nothing if D22 is None else D22)
        if rebuilt is None:
            return None
        named, loop = rebuilt
        (z2, w2), (z, w) = self.channels.h2, self.channels.hinf
        noisy = _selected(loop, z2, w2)
        if not loop.is_discrete:
            cleared = cancelled_direct_term(noisy, self.plant.matrices().D11[np.ix_(z2, w2)], K.D)
            if cleared is None:
                return None
            noisy = cleared
        h2_found, hinf_found = h2_norm(noisy), hinf_norm(_selected(loop, z, w))
        sound = h2_found.status.trustworthy and hinf_found.status.trustworthy and np.isfinite(h2_found.value)
        if sound and hinf_found.upper <= self.gamma:
            self.found.append(_Verified(named, loop, noisy, h2_found, hinf_found, how))
        return (h2_found, hinf_found) if sound else None

    def _weighted_h2(self) -> None:
        """H2 designs in which the H-infinity channel carries more and more weight, up to the first that keeps the
        bound: a quick start that works at any size.
        """
        m = self.plant.model
        (z2, w2), (z, w) = self.channels.h2, self.channels.hinf
        n_z, n_w = m.n_outputs - self.plant.n_meas, m.n_inputs - self.plant.n_con
        for weight in WEIGHTS:
            if self.budget.over:
                return
            rows, columns = np.ones(m.n_outputs), np.ones(m.n_inputs)
            rows[:n_z], columns[:n_w] = 0.0, 0.0
            rows[z], columns[w] = weight, 1.0
            rows[z2], columns[w2] = np.maximum(rows[z2], 1.0), 1.0
            D = rows[:, None] * m.D * columns
            D[:n_z, :n_w] = 0.0  # only a design is looked for; what it is worth is judged on the plant
            shaped = StateSpaceModel(m.A, m.B * columns, rows[:, None] * m.C, D, m.dt, m.inputs, m.outputs, m.states)
            try:
                shaped_plant = GeneralizedPlant(shaped, self.plant.n_meas, self.plant.n_con)
                design = synthesize_h2(shaped_plant, "h2", H2_REL, self.budget)
            except NoTrustworthyNumber:
                continue
            norms = self._judge(design.K, f"an H2 design with weight {weight:.3g} on the H-infinity channel")
            if norms is not None and norms[1].upper <= self.gamma:
                self.say(f"weight {weight:.3g}: H2 {norms[0].value:.6g}, H-inf {norms[1].upper:.6g}")
                return

    def _search(self) -> None:
        matrices = self.plant.matrices()
        (z2, w2), (z, w) = self.channels.h2, self.channels.hinf
        dt = self.plant.model.dt
        gain = cancelling_gain(_rows(matrices, z2, w2), dt, "synth h2-hinf")
        setup, step = solver_work(len(matrices.A), len(z2) + len(w2), len(z) + len(w))
        if setup + 3 * step > self.budget.left:
            self.skipped = "the linear matrix inequalities were too large for the work left: a larger effort tries them"
            self.say(self.skipped)
            return
        for scale in (equilibrated, paths_first):
            scaling = scale(matrices)
            if dt:  # a step has no other unit of time
                scaling = replace(scaling, rate=1.0)
            p = scaling.apply(matrices)
            gain_scaled = gain / scaling.u[:, None] / scaling.y
            problem = CommonLyapunov(
                p.A, p.B2, p.C2, _channel(p, z2, w2), _channel(p, z, w), gain_scaled, self.budget, discrete=bool(dt)
            )

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
            bare_plant = scaling.controller_to_plant(Realisation(bare.A, bare.B, bare.C, bare.D))
            K = StateSpaceModel(*bare_plant, self.plant.model.dt)
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
        low, high = 0.0, LEVELS[-1]
        for level in LEVELS:
            if self.budget.over or not attempt(level, 1.0):
                high = level
                break
            low = level
        if low == 0.0:
            low = next((level for level in LOWER if not self.budget.over and attempt(level, 1.0)), 0.0)
        if low == 0.0:
            return False
        for _ in range(REFINEMENTS):
            middle = 0.5 * (low + high)
            if high == low or self.budget.over:
                break
            low, high = (middle, high) if attempt(middle, 1.0) else (low, middle)
        for factor in SHARES:
            share = factor
            while not self.budget.over and 1e-4 < share < 1e4:
                before = min(v.h2.value for v in self.found)
                # Another share moves the level that the true norm allows: a larger one is tried as well.
                if attempt(low, share) and attempt(1.1 * low, share):
                    low *= 1.1
                if min(v.h2.value for v in self.found) > before * (1 - GAIN):
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
        status, reason = told(
            Status.INACCURATE if doubt else Status.CONVERGED, parts, self.budget, "a better controller"
        )
        (z, w), bound = self.channels.hinf, f"H-infinity norm {best.hinf.upper:.4g} of {self.gamma:.4g} allowed"
        peak = limiting_channels(_selected(best.loop, z, w), best.hinf.frequency)
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
        )


# --- channels ---------------------------------------------------------------------------------------------------------


def _channels(
    plant: GeneralizedPlant, h2_outputs: Names, h2_inputs: Names | None, outputs: Names | None, inputs: Names | None
) -> _Pair:
    zs = plant.model.output_names[: plant.model.n_outputs - plant.n_meas]
    ws = plant.model.input_names[: plant.model.n_inputs - plant.n_con]
    z2 = _positions(h2_outputs, zs, "h2_outputs")
    w2 = list(range(len(ws))) if h2_inputs is None else _positions(h2_inputs, ws, "h2_inputs")
    others = [i for i in range(len(zs)) if i not in z2]
    z = others if outputs is None else _positions(outputs, zs, "hinf_outputs")
    w = list(range(len(ws))) if inputs is None else _positions(inputs, ws, "hinf_inputs")
    for name, found in (("h2_outputs", z2), ("h2_inputs", w2), ("hinf_outputs", z), ("hinf_inputs", w)):
        if not found:
            raise InputError("synth h2-hinf", f"{name} is empty", "at least one channel", "name it by signal names")
    return _Pair((z2, w2), (z, w))


def _positions(names: Names, known: Sequence[str], what: str) -> list[int]:
    names = [names] if isinstance(names, str) else list(names)
    for name in names:
        if name not in known:
            hint = did_you_mean(name, tuple(known))
            raise InputError(f"synth h2-hinf: {what}", f"no signal {name!r}", f"one of {', '.join(known)}", hint)
    return [list(known).index(name) for name in names]


def _part(plant: GeneralizedPlant, z: list[int], w: list[int]) -> GeneralizedPlant:
    """The generalised plant with one of its channels only."""
    m = plant.model
    rows = [*z, *range(m.n_outputs - plant.n_meas, m.n_outputs)]
    columns = [*w, *range(m.n_inputs - plant.n_con, m.n_inputs)]
    return GeneralizedPlant(_selected(m, rows, columns), plant.n_meas, plant.n_con)


def _selected(m: StateSpaceModel, rows: list[int], columns: list[int]) -> StateSpaceModel:
    outputs: list[Signal] = [m.outputs[i] for i in rows]
    inputs: list[Signal] = [m.inputs[i] for i in columns]
    return StateSpaceModel(m.A, m.B[:, columns], m.C[rows], m.D[np.ix_(rows, columns)], m.dt, inputs, outputs, m.states)


def _rows(p: PlantMatrices, z: list[int], w: list[int]) -> PlantMatrices:
    return replace(p, B1=p.B1[:, w], C1=p.C1[z], D11=p.D11[np.ix_(z, w)], D12=p.D12[z], D21=p.D21[:, w])


def _channel(p: PlantMatrices, z: list[int], w: list[int]) -> Channel:
    part = _rows(p, z, w)
    return Channel(part.B1, part.C1, part.D11, part.D12, part.D21)
