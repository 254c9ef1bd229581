"""Seeded samples and vertices of an uncertain model, and the envelope of their time responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.arrays import Array
from robustlab.budget import one_thread
from robustlab.display import Displayable, Facts, listed, number, with_units
from robustlab.dynamics.linear_plant import LinearPlant
from robustlab.dynamics.plant_base import NonlinearPlant, Plant
from robustlab.dynamics.simulation import simulate
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.result import Status, Table, Tabular
from robustlab.statespace import Signal, real_array
from robustlab.uncertainty.blocks import RealScalar
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.batched_members import (
    Deltas,
    Excitation,
    MemberSet,
    blocks_of,
    excitation,
    time_responses,
    vertex_signs,
)

# Largest stored response: samples x times x outputs.
MAX_NUMBERS = 64_000_000
MARGINAL = 1e-9  # share of the largest pole beyond the stability boundary that counts as unstable
LABEL = "sampled: the true envelope may be wider"


@dataclass(frozen=True, eq=False)
class Samples(Tabular, Displayable):
    """Members of an uncertain model, or of a nonlinear plant with tolerances: random ones first, then vertices."""

    uncertain: UncertainModel | NonlinearPlant  # of a plant a parameter with a tolerance is a block
    deltas: Deltas  # a mapping of block names to values for each sample, computed on access
    seed: int  # sample i was drawn from ``SeedSequence(seed, spawn_key=(i,))``: it does not depend on their number
    vertices: int  # (every real delta is -1 or +1), which are the last samples

    def __len__(self) -> int:
        return len(self.deltas)

    def models(self) -> list[Any]:
        """Return the sampled models (real Deltas only), or plants."""
        plant: Any = self.uncertain
        if isinstance(plant, UncertainModel):
            return [plant.evaluate(delta) for delta in self.deltas]
        values = [{k: plant.parameters[k].range.value(d) for k, d in delta.items()} for delta in self.deltas]
        return [plant.with_parameters(**{k: (v, 0.0) for k, v in member.items()}) for member in values]

    @error_context("respond")
    def respond(
        self,
        t: ArrayLike,
        u: Mapping[str, ArrayLike] | ArrayLike | None = None,
        x0: ArrayLike | None = None,
        hold: Literal["zoh", "foh", "spline"] = "zoh",
    ) -> Responses:
        """Time responses of all samples and of the nominal model to one input; stability of plants is not checked.

        Parameters
        ----------
        t
            Times in s, shape (n_t,), with one step; for a discrete model its ``dt``.
        u
            Name -> number or samples (n_t,), other inputs are zero; or an array (n_t,) for a single input, or
            (n_t, n_u). None is a unit step on the only input.
        x0
            Initial state of every member, shape (n_x,); zero by default.
        hold
            As of `robustlab.dynamics.simulation.simulate`.

        Raises
        ------
        InputError
            Complex Deltas (they have no response in real time), a clock that is not uniform, wrong sizes or names.
        NoTrustworthyNumber
            A sample is ill-posed, or a plant leaves its workspace.
        """
        for block in self.deltas.blocks:
            if not block.is_real:
                hint = "a complex Delta has no response in real time; use worst_case(..., metric='hinf')"
                raise InputError("respond", f"block {block.name!r} is complex", "real blocks", hint)
        drive = excitation(self.uncertain.inputs, getattr(self.uncertain, "dt", 0.0), t, u, "respond")
        count = len(self) * len(drive.t) * len(self.uncertain.outputs)
        if count > MAX_NUMBERS:
            found, expected = f"{count:.3g} numbers of response", f"at most {MAX_NUMBERS:.3g}"
            raise InputError("respond", found, expected, "fewer samples or times")
        of = self._of_members if isinstance(self.uncertain, UncertainModel) else self._of_plants
        y, nominal, unstable = of(drive, x0, hold)
        with np.errstate(invalid="ignore"):  # inf - inf, where member and nominal model overflow
            lower, upper = np.minimum(y.min(axis=0), nominal), np.maximum(y.max(axis=0), nominal)
            deviation = np.array([np.abs(member - nominal).max(axis=0) for member in y])
        finite = bool(np.isfinite(lower).all() and np.isfinite(upper).all())
        return Responses(
            t=drive.t,
            u=drive.u,
            y=y,
            nominal=nominal,
            lower=np.where(np.isnan(lower), -np.inf, lower),
            upper=np.where(np.isnan(upper), np.inf, upper),
            worst=tuple(np.where(np.isnan(deviation), np.inf, deviation).argmax(axis=0).tolist()),
            deltas=self.deltas,
            inputs=self.uncertain.inputs,
            outputs=self.uncertain.outputs,
            unstable=tuple(unstable),
            status=Status.CONVERGED if finite else Status.INACCURATE,
        )

    def _of_plants(self, drive: Excitation, x0: ArrayLike | None, hold: Any) -> tuple[Array, Array, list[int]]:
        def response(plant: Any) -> Array:
            record = simulate(plant, drive.t, drive.u, x0, hold=hold)
            return np.column_stack([record.outputs[s.name] for s in plant.outputs])

        return np.array([response(plant) for plant in self.models()]), response(self.uncertain), []

    @one_thread()
    def _of_members(self, drive: Excitation, x0: ArrayLike | None, hold: Any) -> tuple[Array, Array, list[int]]:
        uncertain: Any = self.uncertain
        start = np.zeros(uncertain.M.n_states) if x0 is None else real_array("x0", x0, 1, "respond")
        if len(start) != uncertain.M.n_states:
            raise InputError("respond", f"x0 has {len(start)} entries", f"{uncertain.M.n_states}")
        if hold not in ("zoh", "foh") or (hold == "foh" and uncertain.dt):
            raise InputError("respond", f"hold {hold!r}", "'zoh'" + ("" if uncertain.dt else " or 'foh'"))
        y = np.empty((len(self), len(drive.t), len(uncertain.outputs)))
        unstable: list[int] = []
        members = MemberSet(uncertain)
        for part in blocks_of(len(self), members.block):
            ensemble = members.members(self.deltas.numbers(part))
            for index in part.start + np.flatnonzero(ensemble.ill_posed):
                found = f"sample {index} makes the model ill-posed (I - D11 Delta is singular): {self.deltas[index]}"
                raise NoTrustworthyNumber("respond", found)
            unstable += [part.start + int(i) for i in np.flatnonzero(ensemble.is_unstable(MARGINAL))]
            y[part] = time_responses(ensemble, drive, start, hold)
        return y, time_responses(members.members(np.zeros((1, members.size))), drive, start, hold)[0], unstable

    def facts(self) -> Facts:
        return [
            ("members", f"{len(self)}, of which {self.vertices} vertices; seed {self.seed}"),
            ("of", repr(self.uncertain) if isinstance(self.uncertain, UncertainModel) else self.uncertain.name),
            ("blocks", listed(b.name for b in self.deltas.blocks)),
        ]

    def table(self) -> Table:
        """A row for each sample, parameters in their units where known; matrices as ``NAME[row,column]``."""
        rows, columns, units = list(self.deltas), dict[str, Any](), dict[str, str]()
        for block in self.deltas.blocks:
            entries = [f"{block.name}[{i + 1},{j + 1}]" for i, j in np.ndindex(block.value_shape)]
            drawn = np.array([row[block.name] for row in rows]).reshape(len(rows), -1)
            columns |= zip([block.name] if block.is_scalar else entries, drawn.T, strict=True)
            if (parameter := block.parameter) is not None:
                columns[block.name] = [parameter.value(float(np.real(v))) for v in columns[block.name]]
                units[block.name] = parameter.unit
        return Table(("sample", np.arange(len(rows))), columns, units)

    def to_json(self) -> dict[str, object]:
        return {"deltas": list(self.deltas), "seed": self.seed, "vertices": self.vertices}


@dataclass(frozen=True)
class Responses(Displayable):
    """Time responses of samples, and the envelope of them and the nominal response."""

    t: Array  # times in s, (n_t,)
    u: Array  # input samples, (n_t, n_u)
    y: Array  # outputs, (n_samples, n_t, n_y)
    nominal: Array  # outputs of the nominal model, (n_t, n_y)
    lower: Array  # envelope of the samples and the nominal model, (n_t, n_y); infinite where a response overflows
    upper: Array
    worst: tuple[int, ...]  # for each output the sample with the largest |y - nominal| at any time
    deltas: Sequence[Mapping[str, Any]]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    unstable: tuple[int, ...]  # samples with a pole beyond the stability boundary: they grow with the horizon
    status: Status  # CONVERGED, or INACCURATE where a response overflows
    label: str = LABEL

    @property
    def peak_deviation(self) -> Array:
        """For each output the largest ``|y - nominal|`` over samples and time, shape (n_y,)."""
        return np.maximum(self.upper - self.nominal, self.nominal - self.lower).max(axis=0)

    def facts(self) -> Facts:
        deviations = zip(self.outputs, self.peak_deviation, strict=True)
        return [
            ("members", f"{len(self.deltas)}, {len(self.t)} times to {number(float(self.t[-1]), 's')}"),
            ("outputs", with_units(self.outputs)),
            ("largest deviation", listed(f"{s.name} {number(float(value), s.unit)}" for s, value in deviations)),
            ("unstable", f"{len(self.unstable)} members" if self.unstable else ""),
            ("meaning", self.label),
        ]

    def to_json(self) -> dict[str, object]:
        """All fields except the single responses ``y``, which follow from the Deltas."""
        data = {key: value for key, value in vars(self).items() if key != "y"}
        return {**data, "peak_deviation": self.peak_deviation}


@error_context("sample")
def sample(uncertain: UncertainModel | Plant, n: int, seed: int = 0, vertices: int | Literal["all"] = 0) -> Samples:
    """Draw members of an uncertain model, or of a nonlinear plant whose parameters have tolerances.

    Real parameters are uniform in their ranges (deltas in [-1, 1] where nominal is the middle), complex deltas in the
    unit disc, full blocks random with ``sigma_max <= 1``.

    Parameters
    ----------
    uncertain
        The set; or a nonlinear plant, a functional mock-up unit for example.
    n
        Number of random samples.
    seed
        Seed of the random numbers; sample i is the same for every n.
    vertices
        Number of vertices to add: all ``2^k`` of k real deltas where the number allows it, else a seeded selection;
        ``"all"`` for every one. Complex and full blocks are at random on their boundary there.

    Returns
    -------
    Samples
        The random samples first, then the vertices; models and responses are computed on access.

    Raises
    ------
    InputError
        No samples, or all vertices of more than 16 real deltas; a linear plant, which has an exact set
        (``plant.uncertain()``), or one without tolerances.

    Examples
    --------
    >>> from robustlab import RealScalar, StateSpaceModel
    >>> M = StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> lag = UncertainModel(M, [RealScalar("pole")])
    >>> [delta["pole"] for delta in sample(lag, 0, vertices="all").deltas]
    [-1.0, 1.0]
    """
    if isinstance(uncertain, LinearPlant):
        hint = "plant.uncertain() is one"
        raise InputError("sample", f"the linear plant {uncertain.name}", "an UncertainModel", hint)
    if not isinstance(uncertain, (NonlinearPlant, UncertainModel)):
        raise InputError("sample", type(uncertain).__name__, "an UncertainModel or a nonlinear plant")
    for name, count in (("n", n), ("vertices", 0 if vertices == "all" else vertices), ("seed", seed)):
        checks.whole(name, count)
    if n == 0 and vertices == 0:
        raise InputError("sample", "no samples and no vertices", "at least one of n and vertices")
    if isinstance(uncertain, UncertainModel):
        blocks = uncertain.blocks
    else:
        blocks = tuple(RealScalar(name, 1, p.range) for name, p in uncertain.parameters.items() if p.radius)
        if not blocks:
            known = ", ".join(uncertain.parameters) or "none"
            found = f"no parameter of {uncertain.name} has a tolerance"
            raise InputError("sample", found, f"one of {known} with (value, 0.1)")
    signs = vertex_signs(sum(b.interval is not None for b in blocks), vertices, seed)
    return Samples(uncertain, Deltas(blocks, int(n), int(seed), signs), int(seed), len(signs))
