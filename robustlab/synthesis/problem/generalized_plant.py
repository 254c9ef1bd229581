"""Generalised plants: which inputs are disturbances and controls, which outputs are performance and measurements.

Scaling of a generalised plant by powers of two, undone exactly in the controller.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.display import Displayable, Facts, listed, with_units
from robustlab.errors import InputError, error_context
from robustlab.feedback import wired
from robustlab.norms import bilinear_to_continuous
from robustlab.signals import Taken, signal_positions
from robustlab.statespace import Signal, StateSpaceModel, append, as_model, lower_lft
from robustlab.uncertainty.blocks import Block, structure_size
from robustlab.uncertainty.lft import UncertainModel


class Realisation(NamedTuple):
    """Bare matrices of a loop or a controller inside a search."""

    A: AnyArray
    B: AnyArray
    C: AnyArray
    D: AnyArray

    @classmethod
    def of(cls, model: StateSpaceModel) -> Realisation:
        return cls(model.A, model.B, model.C, model.D)


NO_PERFORMANCE = "mixsyn and ncf make them for a bare plant; in P they come before the controls and measurements"


@dataclass(frozen=True, eq=False)
class PlantMatrices:
    """The bare matrices of a continuous generalised plant with D22 = 0, for the numerics of synthesis."""

    A: Array
    B1: Array
    B2: Array
    C1: Array
    C2: Array
    D11: Array
    D12: Array
    D21: Array

    @classmethod
    def of(cls, system: Realisation, n_w: int, n_z: int) -> PlantMatrices:
        """Return the matrices of a system from [w; u] to [z; y], without D22."""
        A, B, C, D = system
        return cls(A, B[:, :n_w], B[:, n_w:], C[:n_z], C[n_z:], D[:n_z, :n_w], D[:n_z, n_w:], D[n_z:, :n_w])

    @property
    def sizes(self) -> tuple[int, int, int, int, int]:
        """``(n_x, n_w, n_u, n_z, n_y)``."""
        return self.A.shape[0], self.B1.shape[1], self.B2.shape[1], self.C1.shape[0], self.C2.shape[0]

    @property
    def direct_sizes(self) -> tuple[float, float]:
        """Smallest singular values of D12 and of D21; 0 where it cannot have full column or row rank."""
        tall = (D if len(D) >= D.shape[1] else np.zeros((1, 1)) for D in (self.D12, self.D21.T))
        u, y = (float(np.linalg.svd(D, compute_uv=False).min(initial=np.inf)) for D in tall)
        return u, y

    def with_channels(
        self, u: float | Array, y: float | Array, x_out: float | Array, x_in: float | Array
    ) -> PlantMatrices:
        """Add outputs ``u * controls`` and ``x_out * x``, and noises ``y`` on y and ``x_in`` on x."""
        n, _, n_u, n_z, n_y = self.sizes
        C1 = np.vstack([self.C1, np.zeros((n_u, n)), x_out * np.eye(n)])
        D12 = np.vstack([self.D12, u * np.eye(n_u), np.zeros((n, n_u))])
        B1 = np.hstack([self.B1, np.zeros((n, n_y)), x_in * np.eye(n)])
        D21 = np.hstack([self.D21, y * np.eye(n_y), np.zeros((n_y, n))])
        D11 = np.zeros((C1.shape[0], B1.shape[1]))
        D11[:n_z, : self.D11.shape[1]] = self.D11
        return replace(self, B1=B1, C1=C1, D11=D11, D12=D12, D21=D21)

    def whole(self) -> Realisation:
        """Return the system from [w; u] to [z; y]."""
        _, _, n_u, _, n_y = self.sizes
        D = np.block([[self.D11, self.D12], [self.D21, np.zeros((n_y, n_u))]])
        return Realisation(self.A, np.hstack([self.B1, self.B2]), np.vstack([self.C1, self.C2]), D)


def dual(p: PlantMatrices) -> PlantMatrices:
    """Return the transposed plant, in which controls and measurements change places."""
    return PlantMatrices(p.A.T, p.C1.T, p.C2.T, p.B1.T, p.B2.T, p.D11.T, p.D21.T, p.D12.T)


@dataclass(frozen=True, eq=False)
class GeneralizedPlant(Displayable):
    """A model: its last ``n_con`` inputs are the controls u, its last ``n_meas`` outputs the measurements y."""

    model: StateSpaceModel
    n_meas: int
    n_con: int
    blocks: tuple[Block, ...] = ()

    def __post_init__(self) -> None:
        sizes = ("n_meas", self.n_meas, self.model.n_outputs), ("n_con", self.n_con, self.model.n_inputs)
        for name, count, most in sizes:
            if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or not 1 <= count <= most:
                raise InputError("generalised plant", f"{name} is {count!r}", f"a whole number from 1 to {most}")

    @property
    def n_w(self) -> int:
        return self.model.n_inputs - self.n_con

    @property
    def n_z(self) -> int:
        return self.model.n_outputs - self.n_meas

    @property
    def measurements(self) -> tuple[Signal, ...]:
        """The measured outputs y, each with the signal it takes: by default itself."""
        return tuple(s if isinstance(s, Taken) else Taken(*s) for s in self.model.outputs[self.n_z :])

    @property
    def controls(self) -> tuple[Signal, ...]:
        return self.model.inputs[self.n_w :]

    @property
    def D22(self) -> Array:
        """Direct term from u to y, shape (n_meas, n_con)."""
        return self.model.D[self.n_z :, self.n_w :]

    def matrices(self) -> PlantMatrices:
        """Return the matrices without D22."""
        return PlantMatrices.of(Realisation.of(self.model), self.n_w, self.n_z)

    def fitted(self, K: Any, where: str) -> StateSpaceModel:
        """Return a controller with the plant's order and signs of signals; refuse one of another size."""
        k = as_model(getattr(K, "K", K), where)
        if (k.n_outputs, k.n_inputs) != (self.n_con, self.n_meas):
            names = f"from {listed(s.name for s in self.measurements)} to {listed(s.name for s in self.controls)}"
            raise InputError(where, f"K is {k.n_outputs} x {k.n_inputs}", f"{self.n_con} x {self.n_meas}: {names}")
        return wired(k, self.measurements, self.controls, where)

    def close(self, K: StateSpaceModel) -> StateSpaceModel:
        """Return the closed loop from w to z for ``u = K y``; signals are matched by `robustlab.feedback.wired`."""
        return lower_lft(self.model, wired(K, self.measurements, self.controls, "close"))

    def continuous(self) -> GeneralizedPlant:
        """Return the plant, or the image of a discrete one under the bilinear map, which keeps norms."""
        if not self.model.dt:
            return self
        return GeneralizedPlant(bilinear_to_continuous(self.model), self.n_meas, self.n_con)

    def to_model(self) -> StateSpaceModel:
        return self.model

    def facts(self) -> Facts:
        return [
            ("measurements", with_units(self.measurements)),
            ("controls", with_units(self.controls)),
            ("performance", f"{self.n_w} disturbances, {self.n_z} outputs"),
            ("states", str(self.model.n_states)),
            ("blocks", listed(b.name for b in self.blocks)),
        ]


def side_by_side(*models: StateSpaceModel) -> StateSpaceModel:
    """Return the block-diagonal model of several whose signals may have equal names, without units."""
    sides = [(i, range(m.n_inputs), range(m.n_outputs)) for i, m in enumerate(models)]
    names = [([f"u{i}.{k}" for k in ins], [f"y{i}.{k}" for k in outs]) for i, ins, outs in sides]
    return append(*(m.renamed(*own) for m, own in zip(models, names, strict=True)))


def as_generalized_plant(P: Any, n_meas: int | None, n_con: int | None, where: str) -> GeneralizedPlant:
    """Return P as a generalised plant; the two numbers may be left out if P is one already."""
    if isinstance(P, GeneralizedPlant):
        if n_meas not in (None, P.n_meas) or n_con not in (None, P.n_con):
            raise InputError(where, f"n_meas={n_meas}, n_con={n_con}", f"{P.n_meas} and {P.n_con}, or leave them out")
        return P
    if n_meas is None or n_con is None:
        expected = "the numbers of measurements and of controls (they come last in P)"
        raise InputError(where, "n_meas or n_con is missing", expected)
    if isinstance(P, UncertainModel):
        return GeneralizedPlant(P.M, n_meas, n_con, P.blocks)
    return GeneralizedPlant(as_model(P, f"{where}: P"), n_meas, n_con)


def require_performance(plant: GeneralizedPlant, where: str, hint: str = NO_PERFORMANCE) -> None:
    """Refuse a plant without a disturbance w or a performance output z outside its blocks: every norm would be 0."""
    q, p = structure_size(plant.blocks)
    into, out = plant.n_w - q, plant.n_z - p
    if into and out:
        return
    missing = " and ".join(["no disturbance w"] * (not into) + ["no performance output z"] * (not out))
    size = f"P of {plant.model.n_inputs} inputs and {plant.model.n_outputs} outputs has"
    rest = f"in addition to {plant.n_con} controls and {plant.n_meas} measurements"
    if plant.blocks:
        rest += f" and the channels of {listed(b.name for b in plant.blocks)}: no performance channel is left"
    raise InputError(where, f"{size} {missing} {rest}", "at least one of both", hint)


@error_context("generalized_plant")
def generalized_plant(
    model: Any,
    measurements: Sequence[str],
    controls: Sequence[str],
    disturbances: Sequence[str] | None = None,
    performance: Sequence[str] | None = None,
) -> GeneralizedPlant:
    r"""Build a generalised plant from a model or an uncertain model, by signal names.

    Inputs are ordered perturbation, disturbances, controls; outputs perturbation, performance, measurements. An output
    may be both performance and measurement; the measured copy is called ``<name> measured``. Brezina 2010, eq. 10.15.

    Parameters
    ----------
    model
        StateSpaceModel, UncertainModel (its perturbation channels come first) or python-control object.
    measurements, controls
        Names of the measured outputs y and of the inputs u that the controller drives.
    disturbances, performance
        Names of the inputs w and of the outputs z; all inputs except the controls, and all outputs, where left out.

    Returns
    -------
    GeneralizedPlant
        With inputs [Delta's; w; u] and outputs [Delta's; z; y], and the perturbation blocks of an uncertain model.

    Raises
    ------
    InputError
        Unknown names, or no measurement or control.
    """
    if isinstance(model, UncertainModel):
        (q, p), m, blocks = model.delta_shape, model.M, model.blocks
    else:
        (q, p), m, blocks = (0, 0), as_model(model, "generalized_plant"), ()
    ins, outs = m.input_names[q:], m.output_names[p:]
    an_input, an_output = "generalized_plant: input", "generalized_plant: output"
    u, y = signal_positions(controls, ins, an_input), signal_positions(measurements, outs, an_output)
    w = [i for i in range(len(ins)) if i not in u]
    w = w if disturbances is None else signal_positions(disturbances, ins, an_input)
    z = signal_positions(performance, outs, an_output)
    if set(u) & set(w):
        found = "an input is both disturbance and control"
        raise InputError("generalized_plant", found, "two inputs (add one to the model)")
    columns = [*range(q), *(q + i for i in [*w, *u])]
    rows = [*range(p), *(p + i for i in [*z, *y])]
    measured = [_measured(m.outputs[p + i], copied=i in z) for i in y]
    model = StateSpaceModel(
        m.A, m.B[:, columns], m.C[rows], m.D[np.ix_(rows, columns)], m.dt,
        [m.inputs[i] for i in columns], [*(m.outputs[i] for i in rows[: p + len(z)]), *measured], m.states,
        where="generalized_plant",
    )  # fmt: skip
    return GeneralizedPlant(model, len(y), len(u), blocks)


def _measured(s: Signal, copied: bool) -> Signal:
    """Return the measurement of an output; the copy of one that is performance too has a name of its own."""
    if not copied:
        return s
    takes, of = (s.takes, s.of) if isinstance(s, Taken) else ("y", s.name)
    return Taken(f"{s.name} measured", s.unit, takes, of)


@dataclass(frozen=True, eq=False)
class Scaling:
    """Powers of two; ``x = states * x_scaled``, ``u = u * u_scaled``, ``y_scaled = y * y``, time unit ``1/rate``."""

    rate: float
    states: AnyArray
    u: AnyArray
    y: AnyArray
    w: float = 1.0
    z: float = 1.0

    @property
    def gain(self) -> float:
        """Factor from a closed-loop gain of the plant to that of the scaled plant."""
        return float(self.w) * float(self.z)

    def in_steps(self) -> Scaling:
        """Return the same for a discrete plant, whose time unit is the step."""
        return replace(self, rate=1.0)

    def apply(self, p: PlantMatrices) -> PlantMatrices:
        t, u, y, w, z = self.states, self.u, self.y[:, None], self.w, self.z
        rows = t[:, None] * self.rate
        with np.errstate(over="ignore", under="ignore"):
            return PlantMatrices(
                p.A / rows * t, p.B1 / rows * w, p.B2 / rows * u, p.C1 * t * z, p.C2 * t * y,
                p.D11 * w * z, p.D12 * u * z, p.D21 * w * y,
            )  # fmt: skip

    def controller_to_plant(self, K: Realisation) -> Realisation:
        """Return the controller for the plant from one for the scaled plant."""
        u, y = self.u[:, None], self.y
        with np.errstate(over="ignore", under="ignore"):
            return Realisation(K.A * self.rate, K.B * self.rate * y, K.C * u, K.D * u * y)

    def controller_from_plant(self, K: Realisation) -> Realisation:
        """Invert `controller_to_plant`."""
        u, y = self.u[:, None], self.y
        return Realisation(K.A / self.rate, K.B / self.rate / y, K.C / u, K.D / u / y)


def _power(x: AnyArray | float) -> AnyArray:
    """Round to the nearest powers of two; 1 where x is zero."""
    x = np.asarray(x, dtype=float)
    usable = np.isfinite(x) & (x > 0)
    return 2.0 ** np.round(np.log2(np.where(usable, x, 1.0)))


def _rms(x: AnyArray) -> float:
    return float(np.linalg.norm(x) / np.sqrt(max(1, min(x.shape)))) if x.size else 0.0


def _start(p: PlantMatrices) -> Scaling:
    size = np.abs(np.linalg.eigvals(p.A)) if p.A.size else np.zeros(0)
    size = np.sort(size[size > 1e-9 * max(size.max(initial=0.0), 1e-300)])
    rate = float(_power(0.5 * (size[(len(size) - 1) // 2] + size[len(size) // 2]))) if len(size) else 1.0
    n, _, n_u, _, n_y = p.sizes
    return Scaling(rate, np.ones(n), np.ones(n_u), np.ones(n_y))


def _osborne(p: PlantMatrices, states: AnyArray, sweeps: int) -> AnyArray:
    """Return state factors that balance rows of [A B1 B2] against columns of [A; C1; C2], state by state."""
    n, t = len(states), states.copy()
    # The last column has all inputs of each state, the last row all outputs.
    squares = np.zeros((n + 1, n + 1))
    squares[:n, :n] = p.A**2
    squares[:n, n] = (p.B1**2).sum(1) + (p.B2**2).sum(1)
    squares[n, :n] = (p.C1**2).sum(0) + (p.C2**2).sum(0)
    np.fill_diagonal(squares, 0.0)
    for _ in range(sweeps):
        before = t.copy()
        for i in range(n):
            row, column = float(squares[i].sum()), float(squares[:, i].sum())
            if not (0 < row < np.inf and 0 < column < np.inf):
                continue
            power = round(0.25 * (math.log2(row) - math.log2(column)))
            if power:
                squares[i] *= 4.0**-power
                squares[:, i] *= 4.0**power
                t[i] *= 2.0**power
        if (t == before).all():
            break
    return t


def paths_first(p: PlantMatrices) -> Scaling:
    """Scale in three passes: direct paths D12, D21 (C1, B1 if they vanish) to size one, then states, then u and y."""
    s = _start(p)
    q = s.apply(p)
    for last in (False, False, True):
        if (s.z, s.w) == (1.0, 1.0):
            z = float(_power(1 / (_rms(q.D12) or _rms(q.C1) or 1.0)))
            w = float(_power(1 / (_rms(q.D21) or _rms(q.B1) or 1.0)))
            s = replace(s, w=w, z=z)
        s = replace(s, states=_osborne(s.apply(p), s.states, 20))
        if last:
            break
        q = s.apply(p)
        u = _channel(np.linalg.norm(q.D12, axis=0), np.linalg.norm(q.B2, axis=0))
        y = _channel(np.linalg.norm(q.D21, axis=1), np.linalg.norm(q.C2, axis=1))
        s = replace(s, u=s.u / u, y=s.y / y)
        q = s.apply(p)
    return s


def _channel(direct: AnyArray, dynamic: AnyArray) -> AnyArray:
    return _power(np.where(direct > 1e-8, direct, dynamic))


def equilibrated(p: PlantMatrices) -> Scaling:
    """Scale towards rows and columns of size one, until nothing changes or for 30 passes."""
    s = _start(p)
    for _ in range(30):
        before = s
        s = replace(s, states=_osborne(s.apply(p), s.states, 1))
        q = s.apply(p)
        u = _power(np.hypot(np.linalg.norm(q.B2, axis=0), np.linalg.norm(q.D12, axis=0)))
        y = _power(np.hypot(np.linalg.norm(q.C2, axis=1), np.linalg.norm(q.D21, axis=1)))
        s = replace(s, u=s.u / u, y=s.y / y)
        q = s.apply(p)
        w = float(_power(np.hypot(np.linalg.norm(q.B1), np.linalg.norm(q.D21)) / np.sqrt(max(1, q.B1.shape[1]))))
        z = float(_power(np.hypot(np.linalg.norm(q.C1), np.linalg.norm(q.D12)) / np.sqrt(max(1, q.C1.shape[0]))))
        s = replace(s, w=s.w / w, z=s.z / z)
        if all(np.array_equal(getattr(s, k), getattr(before, k)) for k in ("states", "u", "y", "w", "z")):
            break
    return s


def common_scaling(plants: Sequence[GeneralizedPlant]) -> list[Scaling]:
    """Return a scaling for each plant that differ in the states only: signals and time unit are those of the first."""
    matrices = [plant.matrices() for plant in plants]
    first = equilibrated(matrices[0])
    if plants[0].model.dt:
        first = first.in_steps()
    return [first, *(replace(first, states=equilibrated(other).states) for other in matrices[1:])]
