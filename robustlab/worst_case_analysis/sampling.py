"""Seeded samples and vertices of an uncertain model, and the envelope of their time responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Status
from robustlab.statespace import Signal, StateSpaceModel, real_array
from robustlab.uncertainty.blocks import Block, ComplexScalar, RealScalar
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.ensemble import chunks, delta_stack, members, time_responses
from robustlab.worst_case_analysis.excitation import excitation

__all__ = ["Responses", "Samples", "delta_of_sample", "sample", "vertex_signs"]

Array = NDArray[np.float64]

# "all" vertices are listed up to this many real deltas; subsets are drawn from a full list up to the same number.
MAX_LISTED = 16
# A response is kept whole: samples x times x outputs.
MAX_NUMBERS = 64_000_000
# Poles count as unstable beyond this share of the member's largest pole: an integrator is not an instability.
MARGINAL = 1e-9
LABEL = "sampled: the true envelope may be wider"


@dataclass(frozen=True)
class Samples:
    """Members of an uncertain model: seeded random ones first, then vertices.

    Attributes
    ----------
    uncertain
        The model that was sampled.
    deltas
        One mapping of block names to values for each sample.
    seed
        Sample i was drawn from ``SeedSequence(seed, spawn_key=(i,))``: it does not depend on how many are drawn.
    vertices
        How many of the last samples are vertices: every real delta is -1 or +1.
    """

    uncertain: UncertainModel
    deltas: tuple[Mapping[str, Any], ...]
    seed: int
    vertices: int

    def __len__(self) -> int:
        return len(self.deltas)

    def models(self) -> list[StateSpaceModel]:
        """The sampled members (real Deltas only)."""
        return [self.uncertain.evaluate(delta) for delta in self.deltas]

    def respond(
        self,
        t: ArrayLike,
        u: Mapping[str, ArrayLike] | ArrayLike | None = None,
        x0: ArrayLike | None = None,
        hold: Literal["zoh", "foh"] = "zoh",
    ) -> Responses:
        """Time responses of all samples and of the nominal model to one input.

        Parameters
        ----------
        t
            Times in s, shape (n_t,), with one step; for a discrete model its ``dt``.
        u
            Name -> number or samples (n_t,), inputs left out are zero; or an array (n_t,) for a single input, or
            (n_t, n_u). None is a unit step on the only input.
        x0
            Initial state of every member, shape (n_x,); zero where left out.
        hold
            What the input does between samples: "zoh" keeps its value, "foh" goes straight to the next one.

        Raises
        ------
        InputError
            Complex Deltas (they have no response in real time), a clock that is not uniform, wrong sizes or names.
        NoTrustworthyNumber
            A sample is ill-posed: it has no response at all.
        """
        return _respond(self, t, u, x0, hold)

    def to_json(self) -> dict[str, object]:
        """Deltas, seed and number of vertices."""
        return {"deltas": list(self.deltas), "seed": self.seed, "vertices": self.vertices}


@dataclass(frozen=True)
class Responses:
    """Time responses of samples, and the envelope of them and the nominal response.

    Attributes
    ----------
    t
        Times in s, shape (n_t,).
    u
        Input samples, shape (n_t, n_u).
    y
        Outputs, shape (n_samples, n_t, n_y).
    nominal
        Outputs of the nominal model, shape (n_t, n_y).
    lower, upper
        Envelope over the samples and the nominal model, shape (n_t, n_y); infinite where a response outgrew double
        precision.
    worst
        For each output the sample with the largest ``|y - nominal|`` at any time.
    deltas
        The samples' Deltas.
    inputs, outputs
        Signals of u and y.
    unstable
        Samples with a pole beyond the stability boundary (an integrator is none): they grow with the horizon.
    status
        CONVERGED, or INACCURATE where a response outgrew double precision.
    label
        What the envelope is, and is not.
    """

    t: Array
    u: Array
    y: Array
    nominal: Array
    lower: Array
    upper: Array
    worst: tuple[int, ...]
    deltas: tuple[Mapping[str, Any], ...]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    unstable: tuple[int, ...]
    status: Status
    label: str = LABEL

    @property
    def peak_deviation(self) -> Array:
        """For each output the largest ``|y - nominal|`` over samples and time, shape (n_y,)."""
        return np.maximum(self.upper - self.nominal, self.nominal - self.lower).max(axis=0)

    def to_json(self) -> dict[str, object]:
        """All fields; the single responses ``y`` are left out, they follow from the Deltas."""
        data = {key: value for key, value in vars(self).items() if key != "y"}
        data["inputs"], data["outputs"] = [list(s) for s in self.inputs], [list(s) for s in self.outputs]
        return {**data, "peak_deviation": self.peak_deviation}


def sample(uncertain: UncertainModel, n: int, seed: int = 0, vertices: int | Literal["all"] = 0) -> Samples:
    """Draw members of an uncertain model.

    Real deltas are uniform in [-1, 1], complex ones in the unit disc, full blocks random with ``sigma_max <= 1``.

    Parameters
    ----------
    n
        Number of random samples.
    seed
        Same seed, same answer; sample i is the same for every n.
    vertices
        Number of vertices to add: all ``2^k`` of k real deltas where the number allows it, else a seeded selection;
        ``"all"`` asks for every one. Complex and full blocks are put on their boundary there, at random.

    Raises
    ------
    InputError
        Nothing is asked for, or all vertices of more than 16 real deltas.

    Examples
    --------
    >>> M = StateSpaceModel([[-1.0]], [[-0.2, 1.0]], [[1.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    >>> lag = UncertainModel(M, [RealScalar("pole")])
    >>> [delta["pole"] for delta in sample(lag, 0, vertices="all").deltas]
    [-1.0, 1.0]
    """
    if not isinstance(uncertain, UncertainModel):
        raise InputError("sample", type(uncertain).__name__, "an UncertainModel")
    for name, count in (("n", n), ("vertices", 0 if vertices == "all" else vertices), ("seed", seed)):
        if isinstance(count, bool) or not isinstance(count, (int, np.integer)) or count < 0:
            raise InputError("sample", f"{name} is {count!r}", "a whole number, not negative")
    if n == 0 and vertices == 0:
        raise InputError("sample", "no samples and no vertices", "at least one of n and vertices")
    deltas = [delta_of_sample(uncertain.blocks, seed, i) for i in range(n)]
    reals = [b for b in uncertain.blocks if isinstance(b, RealScalar)]
    signs = vertex_signs(len(reals), vertices, seed)
    for i, row in enumerate(signs):
        values = delta_of_sample(uncertain.blocks, seed, i, boundary=True)
        deltas.append({**values, **{b.name: float(s) for b, s in zip(reals, row, strict=True)}})
    return Samples(uncertain, tuple(deltas), int(seed), len(signs))


def delta_of_sample(blocks: Sequence[Block], seed: int, index: int, *, boundary: bool = False) -> dict[str, Any]:
    """Delta of one sample: it depends on the blocks, the seed and the sample's index, and on nothing else.

    Parameters
    ----------
    boundary
        Complex scalars and full blocks on their boundary, as at vertices (drawn apart from the samples inside).

    Examples
    --------
    >>> block = RealScalar("pole")
    >>> delta_of_sample([block], 7, 1)["pole"] == delta_of_sample([block], 7, 1)["pole"]
    True
    """
    key = (index, 1) if boundary else (index,)
    return _random_delta(blocks, np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key)), boundary)


def vertex_signs(k: int, count: int | Literal["all"], seed: int) -> Array:
    """Vertices of the box [-1, 1]^k, shape (n, k): all where ``count`` allows it, else so many seeded ones."""
    if count == "all" and k > MAX_LISTED:
        hint = "ask for a number of vertices"
        raise InputError("sample", f"all vertices of {k} real deltas (2^{k})", f"at most 2^{MAX_LISTED}", hint)
    number = 2**k if count == "all" else count
    if number == 0:
        return np.zeros((0, k))
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(0, 2)))
    if k > MAX_LISTED:
        # Equal draws are rare among so many vertices; where they happen, fewer different ones come back.
        drawn = rng.integers(0, 2, (number, k))
        bits = drawn[np.sort(np.unique(drawn, axis=0, return_index=True)[1])]
        return real_array("vertices", 2 * bits - 1, 2)
    order = np.arange(2**k) if number >= 2**k else rng.permutation(2**k)[:number]
    bits = (order[:, None] >> np.arange(k)[::-1]) & 1
    return real_array("vertices", 2 * bits - 1, 2)


def _random_delta(blocks: Sequence[Block], rng: np.random.Generator, boundary: bool = False) -> dict[str, Any]:
    values: dict[str, Any] = {}
    for block in blocks:
        if isinstance(block, RealScalar):
            values[block.name] = float(rng.uniform(-1.0, 1.0))
            continue
        rows, cols = (1, 1) if isinstance(block, ComplexScalar) else (block.rows, block.cols)
        matrix = rng.standard_normal((rows, cols)) + 1j * rng.standard_normal((rows, cols))
        radius = 1.0 if boundary else rng.random() ** (0.5 / (rows * cols))
        # A hair inside: the norm of the rounded matrix must not come out above one.
        matrix *= radius * (1 - 1e-15) / np.linalg.norm(matrix, 2)
        values[block.name] = complex(matrix[0, 0]) if isinstance(block, ComplexScalar) else matrix
    return values


def _respond(
    samples: Samples,
    t: ArrayLike,
    u: Mapping[str, ArrayLike] | ArrayLike | None,
    x0: ArrayLike | None,
    hold: Literal["zoh", "foh"],
) -> Responses:
    uncertain = samples.uncertain
    for block in uncertain.blocks:
        if not isinstance(block, RealScalar):
            raise InputError(
                "respond",
                f"block {block.name!r} is complex",
                "real blocks",
                "a complex Delta has no response in real time; use worst_case(..., metric='hinf')",
            )
    drive = excitation(uncertain.inputs, uncertain.dt, t, u, "respond")
    start = np.zeros(uncertain.M.n_states) if x0 is None else real_array("x0", x0, 1, "respond")
    if len(start) != uncertain.M.n_states:
        raise InputError("respond", f"x0 has {len(start)} entries", f"{uncertain.M.n_states}")
    if hold not in ("zoh", "foh") or (hold == "foh" and uncertain.dt):
        raise InputError("respond", f"hold {hold!r}", "'zoh'" + ("" if uncertain.dt else " or 'foh'"))
    n_y, count = len(uncertain.outputs), len(samples) * len(drive.t) * len(uncertain.outputs)
    if count > MAX_NUMBERS:
        raise InputError(
            "respond", f"{count:.3g} numbers of response", f"at most {MAX_NUMBERS:.3g}", "fewer samples or times"
        )
    y = np.empty((len(samples), len(drive.t), n_y))
    unstable: list[int] = []
    for part in chunks(len(samples), uncertain.M.A.size + uncertain.M.D.size):
        ensemble = members(uncertain, delta_stack(uncertain.blocks, samples.deltas[part]))
        if ensemble.ill_posed.any():
            index = part.start + int(np.argmax(ensemble.ill_posed))
            raise NoTrustworthyNumber(
                "respond",
                f"sample {index} makes the model ill-posed (I - D11 Delta is singular): {samples.deltas[index]}",
            )
        unstable += [part.start + int(i) for i in np.flatnonzero(ensemble.is_unstable(MARGINAL))]
        y[part] = time_responses(ensemble, drive.h, drive.u, start, hold)
    centre = members(uncertain, np.zeros((1, *uncertain.delta_shape)))
    nominal = time_responses(centre, drive.h, drive.u, start, hold)[0]
    everything = np.concatenate([y, nominal[None]])
    finite = bool(np.isfinite(everything).all())
    lost = np.isnan(everything)
    with np.errstate(invalid="ignore"):  # inf - inf, where member and nominal model outgrow double precision
        deviation = np.nan_to_num(np.abs(y - nominal), nan=np.inf, posinf=np.inf).max(axis=1)
    return Responses(
        drive.t,
        drive.u,
        y,
        nominal,
        np.where(lost, -np.inf, everything).min(axis=0),
        np.where(lost, np.inf, everything).max(axis=0),
        tuple(int(i) for i in deviation.argmax(axis=0)),
        samples.deltas,
        uncertain.inputs,
        uncertain.outputs,
        tuple(unstable),
        Status.CONVERGED if finite else Status.INACCURATE,
    )
