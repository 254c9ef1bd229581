r"""Envelope of the members of an uncertain model under the recorded input, compared with the record.

Covered is not explained: a set that is wide enough covers anything.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np

from robustlab import checks
from robustlab.arrays import Array
from robustlab.display import Each, Facts, number
from robustlab.dynamics.plant_base import NonlinearPlant
from robustlab.errors import InputError, NoTrustworthyNumber, unknown_name
from robustlab.identification.response.response import SHORTEST_START, LinearResponse, response_of, starting_state
from robustlab.record import Record
from robustlab.result import Evidence, Status
from robustlab.uncertainty.lft import UncertainModel
from robustlab.worst_case_analysis.sampling import LABEL, sample


@dataclass(frozen=True)
class SignalCoverage(Evidence):
    """Position of one signal of a record relative to the envelope; percent is of `size`."""

    name: str  # the output, or ``"phi-rate"`` for the mean rate of the output phi
    unit: str
    size: float  # largest measured distance from the first measured value, in `unit`
    share: float  # of the samples inside the envelope, 0..1
    miss: float  # largest distance of a sample from the envelope; 0 if all are inside
    miss_percent: float
    miss_time: float  # its time in s; NaN for none
    miss_side: Literal["", "above", "below"]  # where the record is then
    gap: float  # largest ``|measured - nominal|``
    gap_percent: float
    reach: float  # largest ``|member - nominal|``
    reach_percent: float
    allowance: float  # distance outside the envelope at which a sample still counts as inside
    t: Array  # the series, each of shape (n,)
    measured: Array
    nominal: Array
    lower: Array
    upper: Array

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("size", "miss", "gap", "reach", "allowance"), "*"),
        **dict.fromkeys(("miss_percent", "gap_percent", "reach_percent"), "%"),
        "share": "1",
        "miss_time": "s",
    }

    def to_json(self, series: bool = True) -> dict[str, object]:
        """Return all fields; without ``series`` none of shape (n,)."""
        data = super().to_json()
        return data if series else {k: v for k, v in data.items() if not isinstance(v, np.ndarray)}


@dataclass(frozen=True)
class EnvelopeCoverage(Evidence):
    """Result of `cover`."""

    status: Status  # CONVERGED: every response is finite, and every number follows from the series stored here
    record: str  # name of the record
    signals: Mapping[str, SignalCoverage]  # output name -> `SignalCoverage`; with a rate also ``"<output>-rate"``
    members: int  # number of sampled models besides the nominal one
    seed: int
    label: str = LABEL  # validity of the envelope

    notes: ClassVar[tuple[str, ...]] = (
        "Sampled, not proved: members that were not drawn may reach further.",
        "Covered is not explained: a set that is wide enough covers anything.",
    )
    quantities: ClassVar[Mapping[str, Any]] = {
        "record": str,
        "label": str,
        "covered": bool,
        "members": "1",
        "seed": "1",
        "signals": Each("outputs", SignalCoverage, ("*-rate",)),
    }

    @property
    def covered(self) -> bool:
        """Return whether every sample of every signal is inside."""
        return all(s.share == 1.0 for s in self.signals.values())

    def headline(self) -> str:
        verdict = "is inside the envelope" if self.covered else "is not covered"
        return f"{self.record} {verdict} of {self.members} members (seed {self.seed})"

    def facts(self) -> Facts:
        found: Facts = []
        for s in self.signals.values():
            where = f"{s.miss_side} at {number(s.miss_time, 's')}"
            miss = f"; misses by {number(s.miss, s.unit, 3)} ({s.miss_percent:.3g} %), {where}" if s.miss else ""
            found += [
                (f"{s.name}: inside the envelope", f"{100 * s.share:.3g} % of the time{miss}"),
                (f"{s.name}: error of the nominal model", f"{number(s.gap, s.unit, 3)} ({s.gap_percent:.3g} %)"),
                (f"{s.name}: how far the set reaches", f"{number(s.reach, s.unit, 3)} ({s.reach_percent:.3g} %)"),
            ]
        return found

    def numbers(self) -> dict[str, Any]:
        return self.to_json(series=False)

    def to_json(self, series: bool = True) -> dict[str, object]:
        """Return all fields and `covered`; without ``series`` no time series."""
        signals = {name: s.to_json(series) for name, s in self.signals.items()}
        return {**vars(self), "signals": signals, "covered": self.covered}


def cover(
    uncertain: UncertainModel,
    record: Record,
    *,
    n: int = 20,
    vertices: int | Literal["all"] = 0,
    seed: int = 0,
    rate: float | None = None,
    allowance: Mapping[str, float] | None = None,
) -> EnvelopeCoverage:
    """Simulate members of an uncertain model with the inputs of a record, and check whether they enclose the record.

    The initial state of all members is fitted to the first 20 samples with the nominal model. A miss is a result, not
    an error (Březina 2010, sections 11.1-11.3).

    Parameters
    ----------
    uncertain, record
        The set, whose Delta must be real, and a measurement on a uniform time base of all its inputs and of an output.
    n, vertices, seed
        Members, as in `robustlab.sample`.
    rate
        If given, the mean rate of each output over that many seconds is compared as well: the speed from an encoder.
        An angle integrates a speed error, and returns after a reversal although the speed is wrong.
    allowance
        Output name -> error bound of its sensor (noise, resolution), in the output's unit; default 0. For a rate it is
        twice that over ``rate``.
    """
    require_linear_set("cover", uncertain)
    response = response_of(uncertain.nominal, record)
    names = response.output_names
    allowed = dict.fromkeys(names, 0.0)
    for name, value in (allowance or {}).items():
        where = f"cover {record.name}: allowance of {name!r}"
        if name not in names:
            raise unknown_name(where, "no such compared output", name, names)
        allowed[name] = checks.number(where, value, "a number that is not negative", at_least=0)
    lag = 0 if rate is None or not np.isfinite(rate) else round(rate / record.dt)
    if rate is not None and not 1 <= lag <= record.n // 4:
        span = f"between {record.dt:.6g} and {record.duration / 4:.6g} s"
        raise InputError(f"cover {record.name}", f"rate over {rate:g} s", span)
    shifted, offset = deviations(response.with_units(record), uncertain, names)
    chosen = uncertain.select(outputs=names)
    nominal = response_of(chosen.nominal, shifted)
    # Over the shortest stretch: in a longer one the initial state would absorb a part of the model error.
    start = starting_state(LinearResponse(nominal, nominal.stretch(shifted)), SHORTEST_START)
    drawn = sample(chosen, n, seed, vertices)
    u = {name: shifted.inputs[name] for name in nominal.model.input_names}
    found = drawn.respond(record.t, u, start.x0)
    if not found.status.trustworthy:
        raise NoTrustworthyNumber(f"cover {record.name}", "a member exceeds double precision", None, "a shorter record")
    signals: dict[str, SignalCoverage] = {}
    for k, (name, unit) in enumerate(response.outputs):
        measured, nominal, members = series = (
            record.outputs[name], found.nominal[:, k] + offset[k], found.y[:, :, k] + offset[k]
        )  # fmt: skip
        signals[name] = _coverage(name, unit, record.t, measured, nominal, members, allowed[name])
        if lag:
            seconds, middle = lag * record.dt, 0.5 * (record.t[lag:] + record.t[:-lag])
            measured, nominal, members = ((y[..., lag:] - y[..., :-lag]) / seconds for y in series)
            label, slack = f"{name}-rate", 2 * allowed[name] / seconds
            signals[label] = _coverage(label, f"{unit}/s" if unit else "", middle, measured, nominal, members, slack)
    return EnvelopeCoverage(Status.CONVERGED, record.name, signals, len(drawn), drawn.seed)


def require_linear_set(where: str, uncertain: Any) -> None:
    if isinstance(uncertain, NonlinearPlant):
        hint = "plant.uncertain(at=...) makes one, for the record's deviations from that trim"
        raise InputError(where, f"the nonlinear plant {uncertain.name}", "an uncertain linear model about a trim", hint)
    if not isinstance(uncertain, UncertainModel):
        raise InputError(where, type(uncertain).__name__, "an UncertainModel", "plant.uncertain() makes one")


def _coverage(
    name: str, unit: str, t: Array, measured: Array, nominal: Array, members: Array, allowance: float
) -> SignalCoverage:
    """Compare one signal with the envelope of its members (k, n) and its nominal response (n,)."""
    lower = np.minimum(members.min(axis=0), nominal)
    upper = np.maximum(members.max(axis=0), nominal)
    outside = np.maximum(np.maximum(lower - measured, measured - upper) - allowance, 0.0)
    size = float(np.abs(measured - measured[0]).max())
    worst = int(outside.argmax())
    miss = float(outside[worst])
    gap, reach = np.abs(measured - nominal).max(), np.maximum(upper - nominal, nominal - lower).max()
    far = {"miss": miss, "gap": float(gap), "reach": float(reach)}
    percent = {f"{key}_percent": 100.0 * value / size if size else np.nan for key, value in far.items()}
    return SignalCoverage(
        name=name,
        unit=unit,
        size=size,
        share=float(np.mean(outside == 0)),
        miss_time=float(t[worst]) if miss else np.nan,
        miss_side="" if miss == 0 else "above" if measured[worst] > upper[worst] else "below",
        allowance=allowance,
        t=t,
        measured=measured,
        nominal=nominal,
        lower=lower,
        upper=upper,
        **far,
        **percent,
    )


def deviations(record: Record, uncertain: UncertainModel, names: tuple[str, ...]) -> tuple[Record, Array]:
    """Return the record in deviations from the operating point of the set, and the outputs there (n_y,)."""
    point = uncertain.operating_point
    if point is None:
        return record, np.zeros(len(names))
    at_u = dict(zip([s.name for s in uncertain.inputs], point.u, strict=True))
    at_y = dict(zip([s.name for s in uncertain.outputs], point.y, strict=True))
    inputs = {name: record.inputs[name] - value for name, value in at_u.items()}
    outputs = {name: record.outputs[name] - at_y[name] for name in names}
    units = {name: record.units[name] for name in (*inputs, *outputs)}
    return Record(record.t, inputs, outputs, units, record.name), np.array([at_y[name] for name in names])
