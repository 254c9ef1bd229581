"""Result of `validate`: bounds of the smallest Delta, its replayed explanation, and the evidence for both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np

from robustlab.arrays import AnyArray, Array
from robustlab.display import Each, Facts, number
from robustlab.errors import NoTrustworthyNumber
from robustlab.identification.validation.sampled_problem import Found, Search
from robustlab.result import Evidence, Status, Table, Tabular
from robustlab.statespace import Signal

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
        size = f"size {self.size:.4g} in the explanation" if np.isfinite(self.size) else ""
        physical = number(*self.physical, 6) if self.physical is not None else ""
        impossible = f"physically impossible ({self.impossible})" if self.impossible else ""
        return "; ".join(filter(None, (size, physical, impossible)))


@dataclass(frozen=True, kw_only=True)
class Validation(Tabular, Evidence):
    """The smallest scaling gamma of Delta with which an uncertain model could have produced a record."""

    # CERTIFIED: both bounds were re-derived from their evidence and are within the requested precision. CONVERGED: each
    # bound holds as labelled, and either they are that close or they decide about gamma = 1. INCONCLUSIVE: they do not
    # decide. INFEASIBLE: no Delta of any size explains the record. TIMEOUT: the time limit ended the search.
    status: Status
    record: str
    # No Delta with all blocks smaller than `lower` explains the record; one of size `upper` does. inf: none was found.
    lower: float
    upper: float
    label: str  # methods behind the bounds, and when they are exact
    blocks: Mapping[str, BlockSize]
    noise_bound: Mapping[str, float]  # of each output, in its unit
    noise_norm: str
    # Remaining noise over its bound: at most 1. If no Delta explains the record, the factor by which the noise bound
    # would have to grow.
    excess: float
    replay_error: float  # largest difference between two ways to compute the explained outputs, over the noise bound
    assumptions: tuple[str, ...]
    # In time: samples. Over frequency: one mean period of the record, or the frequencies of a measured response, of
    # which the outputs are magnitudes.
    t: Array  # (n,)
    measured: Array  # outputs (n, n_y) as recorded, of the nominal model, and of the explanation (NaN for none)
    nominal: Array
    explained: Array
    outputs: tuple[tuple[str, str], ...]  # names and units
    # w = Delta z in the explanation, in their own units; over frequency complex, one row for a line
    w: AnyArray = field(default_factory=lambda: np.zeros((0, 0)))
    z: AnyArray = field(default_factory=lambda: np.zeros((0, 0)))
    multipliers: Mapping[str, Array] = field(default_factory=dict)  # the certificate of the lower bound
    domain: Literal["time", "frequency"] = "time"
    omega: Array = field(default_factory=lambda: np.zeros(0))  # of the lines in rad/s; empty in time
    line_sizes: Array = field(default_factory=lambda: np.zeros((0, 0)))  # (n_lines, blocks) in the explanation
    notes: tuple[str, ...] = ()  # why the search ended before its precision was reached: work or time limit

    @property
    def verdict(self) -> str:
        """Return the verdict on gamma = 1 in words."""
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
        """Return whether no Delta of the set (gamma = 1) explains the record."""
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


def concluded(found: Found, search: Search, outputs: Sequence[Signal], **own: Any) -> Validation:
    """Return the result of either domain; ``own``: the fields that do not follow from the bounds."""
    w, z = found.w.copy(), found.z.copy()
    if found.problem is not None:
        for block, size in zip(found.problem.blocks, found.problem.scale, strict=True):  # undo the scaling
            w[:, block[0]] *= size
            z[:, block[1]] *= size
    remark = search.budget.remark
    return Validation(
        status=_status(found, search),
        lower=float(min(found.lower, found.upper)),
        upper=float(found.upper),
        label=found.label,
        excess=found.excess,
        outputs=tuple((s.name, s.unit) for s in outputs),
        w=w,
        z=z,
        multipliers={} if (by := found.multipliers) is None else {"energy": by.D, "noise": by.noise},
        notes=(remark,) if remark else (),
        **own,
    )


def _status(found: Found, search: Search) -> Status:
    if np.isinf(found.lower):
        return Status.INFEASIBLE
    if search.budget.struck:
        return Status.TIMEOUT
    width = 1.01 * search.precision * max(found.upper, SMALLEST)
    if np.isfinite(found.upper) and found.upper - found.lower <= width:
        return Status.CERTIFIED if found.certified else Status.CONVERGED
    return Status.CONVERGED if found.lower > 1 or found.upper <= 1 else Status.INCONCLUSIVE


def require_replay(error: float, record: str) -> float:
    """Return the difference of an explanation and its replay, over the noise bound; refuse a large one."""
    if not error <= REPLAYED:
        found = f"the explanation is off by {error:.1e} of the noise bound when replayed"
        raise NoTrustworthyNumber(f"validate {record}", found)
    return error
