"""Result of `validate`: bounds of the smallest Delta, its replayed explanation, and the evidence for both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.display import Each, Facts, number
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.sampled_problem import Search
from robustlab.result import Evidence, Status, Table, Tabular

SMALLEST = 1e-6  # smaller sizes count as zero
REPLAYED = 1e-3  # largest difference between an explanation and its replay, over the noise bound


@dataclass(frozen=True)
class BlockSize(Evidence):
    """One block of Delta."""

    name: str
    kind: Literal["constant", "time-invariant", "time-varying"]
    size: float  # in the explanation; NaN if nothing explains the record
    value: Any = None  # of a constant; a system is given by its signals w and z, which exist by the theorem
    physical: tuple[float, str] | None = None  # value and unit of the parameter that a constant represents
    impossible: str = ""  # physical condition that the parameter violates; empty for none

    @property
    def in_words(self) -> str:
        texts = [f"size {self.size:.4g} in the explanation"] if np.isfinite(self.size) else []
        texts += [number(*self.physical, 6)] if self.physical is not None else []
        texts += [f"physically impossible ({self.impossible})"] if self.impossible else []
        return "; ".join(texts)


@dataclass(frozen=True, kw_only=True)
class Validation(Tabular, Evidence):
    r"""The smallest scaling gamma of Delta with which an uncertain model could have produced a record.

    Attributes
    ----------
    status
        CERTIFIED: both bounds were re-derived from their evidence and are within the requested precision. CONVERGED:
        each bound holds as labelled, and either they are that close or they decide about gamma = 1. INCONCLUSIVE: they
        do not decide. INFEASIBLE: no Delta of any size explains the record. TIMEOUT: the time limit ended the
        search.
    record
        Name of the record.
    lower, upper
        No Delta with all blocks smaller than ``lower`` explains the record; one of size ``upper`` does. inf if none
        was found.
    label
        Methods behind the bounds, and when they are exact.
    blocks
        Block name -> `BlockSize`.
    noise_bound, noise_norm
        Bound of each output, in its unit, and its norm.
    excess
        Remaining noise over its bound: at most 1. If no Delta explains the record, the factor by which the noise bound
        would have to grow.
    replay_error
        Largest difference between two ways to compute the explained outputs, over the noise bound.
    assumptions
        Assumptions of the bounds.
    t, measured, nominal, explained, outputs
        Time (n,), outputs (n, n_y) as recorded, of the nominal model, and of the explanation (NaN for none); names and
        units.
    w, z
        Signals of the dynamic blocks in the explanation, in their own units: w = Delta z.
    multipliers
        The certificate of the lower bound: arrays by name.
    domain
        ``"time"`` or ``"frequency"``. In the frequency domain t is one mean period of the record, or holds the
        frequencies of a measured response (then the outputs are magnitudes); w and z are complex, one row for a line.
    omega, line_sizes
        Frequencies of the lines in rad/s (n_lines,), and the size of each block there in the explanation
        (n_lines, blocks); empty in the time domain.
    notes
        Reason why the search ended before its precision was reached: its work, or the time limit.
    """

    status: Status
    record: str
    lower: float
    upper: float
    label: str
    blocks: Mapping[str, BlockSize]
    noise_bound: Mapping[str, float]
    noise_norm: str
    excess: float
    replay_error: float
    assumptions: tuple[str, ...]
    t: Array
    measured: Array
    nominal: Array
    explained: Array
    outputs: tuple[tuple[str, str], ...]
    w: AnyArray = field(default_factory=lambda: np.zeros((0, 0)))
    z: AnyArray = field(default_factory=lambda: np.zeros((0, 0)))
    multipliers: Mapping[str, Array] = field(default_factory=dict)
    domain: Literal["time", "frequency"] = "time"
    omega: Array = field(default_factory=lambda: np.zeros(0))
    line_sizes: Array = field(default_factory=lambda: np.zeros((0, 0)))
    notes: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """``"not invalidated at gamma = ..."``, ``"invalidated: gamma is at least ..."``, or why it is undecided."""
        if self.status is Status.INFEASIBLE:
            return "invalidated at every gamma"
        if self.invalidated:
            known = f", and {self.upper:.4g} explains it" if np.isfinite(self.upper) else ""
            return f"invalidated: gamma is at least {self.lower:.4g}{known}"
        if self.upper <= 1:
            return f"not invalidated at gamma = {self.upper:.4g}"
        if np.isinf(self.upper) and not self.lower:
            return f"undecided: the smallest noise found is {self.excess:.4g} times its bound"
        return f"undecided: the smallest gamma is between {self.lower:.4g} and {self.upper:.4g}"

    @property
    def invalidated(self) -> bool:
        """Whether no Delta of the set (gamma = 1) explains the record."""
        return self.lower > 1

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("gamma", "lower", "upper", "excess", "replay_error"), "1"),
        **dict.fromkeys(("record", "verdict", "label", "noise_norm", "domain"), str),
        "invalidated": bool,
        "blocks": {"*": BlockSize},
        "noise_bound": Each("outputs", "*"),
        "outputs": [[str]],
        "assumptions": [str],
        "notes": [str],
    }

    @property
    def gamma(self) -> float:
        """Smallest known scaling that explains the record: ``upper``."""
        return self.upper

    def headline(self) -> str:
        return f"{self.record} as its record: {self.verdict}"

    def facts(self) -> Facts:
        units = dict(self.outputs)
        return [
            ("record", self.record),
            ("verdict", self.verdict),
            ("smallest gamma", f"{number(self.lower)} .. {number(self.upper)}"),
            ("noise left", f"{number(self.excess)} of its {self.noise_norm} bound"),
            ("bounds", self.label),
            *((f"{b.name} ({b.kind})", b.in_words) for b in self.blocks.values()),
            *(
                (f"{name}: noise bound ({self.noise_norm})", number(bound, units[name], 3))
                for name, bound in self.noise_bound.items()
            ),
            *(("assumed", text) for text in self.assumptions),
            ("caution", "Not invalidated is not proved: another record may still invalidate the set."),
        ]

    def table(self) -> Table:
        """Return a row for each block: its size in the explanation."""
        columns = {key: [getattr(b, key) for b in self.blocks.values()] for key in ("kind", "size")}
        return Table(("block", list(self.blocks)), columns)

    def to_json(self, series: bool = True) -> dict[str, object]:
        """Return all fields; without ``series`` no time series and no multipliers."""
        long = ("t", "measured", "nominal", "explained", "w", "z", "multipliers", "omega", "line_sizes")
        data = {k: v for k, v in vars(self).items() if series or k not in long}
        return {**data, "verdict": self.verdict, "invalidated": self.invalidated}


# --- conclusions of both domains -------------------------------------------------------------------------------------


def concluded(lower: float, upper: float, search: Search, *, certified: bool = True) -> Status:
    """Return the status of two bounds; ``certified`` if both were re-derived from their evidence."""
    if np.isinf(lower):
        return Status.INFEASIBLE
    if search.budget.struck:
        return Status.TIMEOUT
    if np.isfinite(upper) and upper - lower <= 1.01 * search.precision * max(upper, SMALLEST):
        return Status.CERTIFIED if certified else Status.CONVERGED
    if lower > 1 or upper <= 1:
        return Status.CONVERGED
    return Status.INCONCLUSIVE


def in_own_units(
    w: AnyArray, z: AnyArray, blocks: Sequence[tuple[slice, slice, bool] | tuple[slice, slice]], scale: Array
) -> tuple[AnyArray, AnyArray]:
    """Undo the scaling of w and z of every block."""
    w, z = w.copy(), z.copy()
    for block, size in zip(blocks, scale, strict=True):
        w[:, block[0]] *= size
        z[:, block[1]] *= size
    return w, z


def require_replay(error: float, record: str) -> None:
    """Refuse an explanation whose replay differs from it by ``error`` of the noise bound."""
    if not error <= REPLAYED:
        found = f"the explanation is off by {error:.1e} of the noise bound when replayed"
        raise NoTrustworthyNumber(f"validate {record}", found)
