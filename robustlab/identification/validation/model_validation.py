r"""Smallest scaling of Delta with which an uncertain model could have produced a record, and the set that data need.

In time: Poolla et al., IEEE TAC 39 (1994) 951-959. Over frequency: Smith, Doyle, IEEE TAC 37 (1992) 942-952.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.budget import MILLION, one_thread, search_budget
from robustlab.display import Facts, listed, number
from robustlab.dynamics.extended.effect_blocks import EffectLoads, NoiseInput, effect_loads
from robustlab.errors import InputError, error_context
from robustlab.identification.comparison.envelope import require_linear_set
from robustlab.identification.validation.frequency_domain import FrequencyData, validate_by_lines
from robustlab.identification.validation.sampled_problem import Search, prepared
from robustlab.identification.validation.time_domain import validate_by_samples
from robustlab.identification.validation.validation_result import Validation
from robustlab.record import Record
from robustlab.result import Evidence, Status, least_trusted
from robustlab.statespace import StateSpaceModel
from robustlab.uncertainty.blocks import FullBlock
from robustlab.uncertainty.lft import UncertainModel, product

# Budget of a validation in units of `robustlab.budget`: about two minutes. More work gives tighter bounds.
WORK = 120 * MILLION


@error_context("validate")
def validate(
    uncertain: UncertainModel,
    record: Record | FrequencyData,
    noise: Mapping[str, ArrayLike],
    *,
    domain: Literal["time", "frequency"] = "time",
    at_rest: bool = False,
    window: float | None = None,
    precision: float = 0.01,
    time_limit: float | None = None,
    progress: Callable[[str], None] | None = None,
    effort: float = 1.0,
) -> Validation:
    """Compute the smallest scaling of Delta with which an uncertain model could have produced a record.

    Parameters
    ----------
    uncertain
        The set. Real blocks are constants; complex and full blocks are causal systems, over frequency time-invariant.
        A continuous model is sampled with all inputs, also w, held between samples. Without a block noise alone must
        explain the record: gamma is 0, or there is none.
    record
        The measurement on a uniform time base, with all inputs of the set and some of its outputs; or `FrequencyData`.
    noise
        Output name -> bound of its noise, in its unit: of every sample in the time domain; in the frequency domain of
        the root mean square over the periods of a record, or at each line of a frequency response, where it may be one
        value for each line.
    domain
        ``"time"``: sample by sample (Poolla et al.). ``"frequency"``: line by line (Smith and Doyle), from whole
        periods of a record in steady state or from `FrequencyData`.
    at_rest
        The record starts at equilibrium. Otherwise the observable states are free at the start; Delta starts at zero.
    window
        Cut the record into windows of that many seconds, each with a free initial state; the state of Delta continues.
        A weaker test, for records over which an open-loop response drifts.
    precision
        Relative width of the bounds to be reached.
    time_limit
        In s. If it is reached, the status is TIMEOUT and the result depends on the machine.
    progress
        Called with one line at each step.
    effort
        Work of the search as a multiple of the usual (about two minutes); counted, not timed.

    Returns
    -------
    Validation
        With both bounds, the Delta and the noise that explain the record, and the certificate of the lower bound.

    Raises
    ------
    InputError
        Signals that do not fit, an output without a noise bound, blocks that a domain cannot judge.
    NoTrustworthyNumber
        Irregular sampling, a noise bound of zero, a record that is not steady, a solver that gives no answer.

    Examples
    --------
    >>> from robustlab.statespace import StateSpaceModel
    >>> from robustlab.uncertainty.unstructured import unstructured
    >>> gain = unstructured(StateSpaceModel([], [], [], [[2.0]], dt=1.0), 1.0)
    >>> steps = Record(range(4), {"u1": [1, 0, 0, 0]}, {"y1": [2.5, 0, 0, 0]})
    >>> found = validate(gain, steps, {"y1": 0.1}, at_rest=True)
    >>> round(found.upper, 2), found.invalidated, str(found.status)
    (0.4, False, 'certified')
    """
    budget = search_budget("validate", WORK, effort, time_limit)
    require_linear_set("validate", uncertain)
    for block in uncertain.blocks:
        if block.is_real and not block.interval:
            found = f"a {type(block).__name__}"
            raise InputError(f"validate: block {block.name!r}", found, "real scalars, complex and full blocks")
    checks.number("validate: precision", precision, at_least=1e-4, at_most=0.2)
    checks.choice("validate: domain", domain, ("time", "frequency"))
    report = progress or (lambda _line: None)
    search = Search(precision, budget)
    if domain == "frequency" or isinstance(record, FrequencyData):
        where = f"validate {record.name}"
        if domain == "time":
            raise InputError(where, "a frequency response in the time domain", 'domain="frequency"')
        for name, given in (("windows", window), ("at_rest", at_rest)):
            if given:
                found = f"{name} in the frequency domain"
                raise InputError(where, found, "whole periods in steady state", 'domain="time"')
        with one_thread():
            return validate_by_lines(uncertain, record, noise, search, report)
    with one_thread():
        recorded = prepared(uncertain, record, noise, window=window, at_rest=at_rest)
        return validate_by_samples(record, recorded, search, report)


LEAST_RADIUS = 0.02  # of `data_cover`: no plant is known better than this at every frequency
PRECISION = 0.02  # of each validation
LOAD_ACCURACY = 1e-3  # of loads along a record (means over its samples), over their bounds


@dataclass(frozen=True, kw_only=True)
class DataCover(Evidence):
    """A set of models that explains its records."""

    status: Status  # the least trusted of all validations, also of the held-out records
    # The set; its inputs are the loads, each at most one, then the plant's. None if no radius explains a record.
    model: UncertainModel | None
    radius: float  # of the unmodelled dynamics in `model`
    needed: float  # smallest radius that explains all records, from above and from below
    needed_lower: float
    held_out: float  # smallest radius for the held-out records, from above; NaN without such
    # Largest load along those records, over its bound; NaN without such, 0 without loads. Above one the loads of the
    # set are too small for them: the bound of a force without its own is that along the records, times the margin.
    held_out_loads: float
    loads: tuple[NoiseInput, ...]  # name, bound, unit and origin of each
    validations: Mapping[str, Validation]  # by the name of the record; gamma is the radius

    quantities: ClassVar[Mapping[str, Any]] = {
        **dict.fromkeys(("radius", "needed", "needed_lower", "held_out", "held_out_loads"), "1"),
        "passes": bool, "blocks": [str], "loads": {"*": float},
    }  # fmt: skip

    @property
    def passes(self) -> bool:
        """Return whether the set explains the held-out records, with loads within their bounds."""
        return self.held_out <= self.radius and self.held_out_loads <= 1 + LOAD_ACCURACY

    def facts(self) -> Facts:
        held = "none"
        if not np.isnan(self.held_out):
            held = f"needs {number(self.held_out)}: {'explained' if self.passes else 'NOT explained'}"
            if self.loads:
                held += f", with loads up to {number(self.held_out_loads, digits=3)} of their bounds"
        return [
            ("unmodelled dynamics", f"{number(self.radius)} of the input"),
            ("needed by the records", f"{number(self.needed_lower)} .. {number(self.needed)}"),
            ("held out", held),
            ("loads", listed(f"{x.name} {number(x.bound, x.unit)}" for x in self.loads)),
            ("records", listed(self.validations)),
        ]

    def numbers(self) -> dict[str, Any]:
        """Return all fields but the validations and the model; of loads their bounds."""
        data = {k: x for k, x in self.to_json(series=False).items() if k not in ("validations", "status")}
        return {**data, "loads": {x.name: x.bound for x in self.loads}}

    notes: ClassVar[tuple[str, ...]] = (
        "The radius is sought at nominal parameters, with a Δ that may vary with time; their tolerances come on top.",
    )

    def to_json(self, series: bool = True) -> dict[str, object]:
        """Return all fields but the model; without ``series`` no time series of the validations."""
        data: dict[str, object] = {k: v for k, v in vars(self).items() if k not in ("model", "validations")}
        return {
            **data,
            "passes": self.passes,
            "blocks": [] if self.model is None else [b.name for b in self.model.blocks],
            "validations": {name: v.to_json(series) for name, v in self.validations.items()},
        }


@error_context("data_cover")
def data_cover(
    plant: Any,
    records: Sequence[Record],
    noise: Mapping[str, float],
    *,
    held_out: Sequence[Record] = (),
    margin: float = 1.1,
    least: float = LEAST_RADIUS,
    window: float | None = None,
    at_rest: bool = False,
    time_limit: float | None = None,
    effort: float = 1.0,
) -> DataCover:
    """Construct the set of models around a plant, with or without effects, that explains its records.

    Parameters
    ----------
    plant
        `LinearPlant` or `ExtendedPlant` with bounded effects; a load is known along a record (`EffectLoads.along`).
    records
        Records that the set must explain.
    noise
        Output name -> bound of its noise; the outputs that are compared.
    held_out
        Records on which the set is checked; they do not change it.
    margin, least
        The radius is ``margin`` times the smallest that explains the records, and at least ``least``; the bound of a
        load without its own is ``margin`` times the largest along the records.
    window, at_rest, time_limit, effort
        As in `validate`; time limit and effort are per record. Delta may vary with time, as friction does.

    Returns
    -------
    DataCover
        ``.model`` is the set, ``.radius`` the size of its unmodelled dynamics over the input, ``.passes`` whether it
        explains the held-out records.

    Raises
    ------
    InputError
        No record, an effect without a bound, signals that do not fit, a margin below one.
    NoTrustworthyNumber
        As in `validate`.

    Examples
    --------
    >>> from robustlab.dynamics import plant, simulate
    >>> weak = simulate(plant("servo-axis", gain=28.0), [0.01 * k for k in range(200)], [1.0] * 200)
    >>> found = data_cover(plant("servo-axis", gain=35.0), [weak], {"q": 1e-6}, at_rest=True)
    >>> round(found.needed, 2)
    0.2
    """
    if not records:
        raise InputError("data_cover", "no record", "at least one")
    checks.number("data_cover: margin", margin, "1 or more", at_least=1)
    checks.number("data_cover: least", least, "0 or more, below 1", at_least=0, below=1)
    names = [r.name for r in (*records, *held_out)]
    if len(set(names)) < len(names):
        raise InputError("data_cover", "two records of one name", "names of their own")
    made = effect_loads(plant, records=records, margin=margin)
    seen = made.model.nominal.select([s.name for s in made.model.inputs], list(noise))
    bare = _unmodelled(UncertainModel(seen, []), made, 1.0)
    found, reached = dict[str, Validation](), dict[str, float]()
    for record in (*records, *held_out):
        driven = made.along(record)
        reached[record.name] = max((float(np.abs(driven[x.name]).max()) for x in made.loads), default=0.0)
        found[record.name] = validate(
            bare, driven, noise, at_rest=at_rest, window=window, precision=PRECISION, time_limit=time_limit,
            effort=effort,
        )  # fmt: skip
    mine = [found[r.name] for r in records]
    needed = max(v.upper for v in mine)
    radius = max(margin * needed, least)
    return DataCover(
        status=least_trusted([v.status for v in found.values()]),
        model=_unmodelled(made.model, made, radius) if np.isfinite(needed) else None,
        radius=radius,
        needed=needed,
        needed_lower=max(v.lower for v in mine),
        held_out=max((found[r.name].upper for r in held_out), default=float("nan")),
        held_out_loads=max((reached[r.name] for r in held_out), default=float("nan")),
        loads=made.loads,
        validations=found,
    )


def _unmodelled(whole: UncertainModel, made: EffectLoads, radius: float) -> UncertainModel:
    """Add ``(I + radius Delta)`` at the plant's own inputs, one block for each."""
    inputs, k, n = whole.inputs, len(made.loads), len(whole.inputs)
    n_u, own = n - k, np.eye(n)[k:]
    d = np.block([[np.zeros((n_u, n_u)), radius * own], [own.T, np.eye(n)]])
    names = [f"unmodelled@{s.name}" for s in inputs[k:]]
    gate = StateSpaceModel(
        np.zeros((0, 0)), np.zeros((0, n_u + n)), np.zeros((n_u + n, 0)), d, whole.M.dt,
        [*(f"w_{name}" for name in names), *inputs], [*(f"z_{name}" for name in names), *inputs], where="data_cover",
    )  # fmt: skip
    origin = f"unmodelled dynamics, {radius:.3g} of the input"
    blocks = [FullBlock(name, 1, 1, origin=origin) for name in names]
    return product(whole, UncertainModel(gate, blocks))
