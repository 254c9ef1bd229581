r"""Smallest scaling of Delta with which an uncertain model could have produced a record.

In time: Poolla et al., IEEE TAC 39 (1994) 951-959. Over frequency: Smith, Doyle, IEEE TAC 37 (1992) 942-952.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

from numpy.typing import ArrayLike

from robustlab import checks
from robustlab.budget import MILLION, one_thread, search_budget
from robustlab.errors import InputError, error_context
from robustlab.identification.comparison.envelope import require_linear_set
from robustlab.identification.validation.frequency_domain import FrequencyData, validate_by_lines
from robustlab.identification.validation.sampled_problem import Search, prepared
from robustlab.identification.validation.time_domain import validate_by_samples
from robustlab.identification.validation.validation_result import Validation
from robustlab.record import Record
from robustlab.uncertainty.lft import UncertainModel

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
