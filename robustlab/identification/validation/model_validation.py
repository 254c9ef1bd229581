r"""Smallest scaling of Delta with which an uncertain model could have produced a record.

In time: Poolla et al., IEEE TAC 39 (1994) 951-959. Over frequency: Smith, Doyle, IEEE TAC 37 (1992) 942-952.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from robustlab.budget import MILLION, one_thread, search_budget
from robustlab.errors import InputError, NoTrustworthyNumber, error_context
from robustlab.identification.comparison.envelope import require_linear_set
from robustlab.identification.comparison.repeats import noise_floor
from robustlab.identification.validation.frequency_domain import FrequencyData, fits_frequency_domain, validate_by_lines
from robustlab.identification.validation.sampled_problem import NoiseNorm, Search, prepared
from robustlab.identification.validation.time_domain import validate_by_samples
from robustlab.identification.validation.validation_result import Validation
from robustlab.record import Record
from robustlab.uncertainty.lft import UncertainModel

# Budget of a validation in units of `robustlab.budget`: about two minutes. More work gives tighter bounds.
WORK = 120 * MILLION
CONFIDENCE = 0.99  # that noise is within a bound estimated from repeats


@error_context("validate")
def validate(
    uncertain: UncertainModel,
    record: Record | FrequencyData,
    noise: Mapping[str, ArrayLike] | None = None,
    *,
    domain: Literal["time", "frequency"] = "time",
    noise_norm: NoiseNorm | None = None,
    at_rest: bool = False,
    window: float | None = None,
    period: float | None = None,
    precision: float = 0.01,
    time_limit: float | None = None,
    progress: Callable[[str], None] | None = None,
    effort: float = 1.0,
) -> Validation:
    """Compute the smallest scaling of Delta with which an uncertain model could have produced a record.

    Parameters
    ----------
    uncertain
        The set. Real blocks are constants; complex and full blocks are causal systems: in the time domain they may vary
        in time, in the frequency domain they are time-invariant. A continuous model is sampled
        with all inputs, also w, held between samples. Without a block noise alone must explain the record: gamma is 0,
        or there is none.
    record
        The measurement, on a uniform time base; all inputs of the set must be recorded, and some of its outputs. In the
        frequency domain also a measured frequency response (`FrequencyData`).
    noise
        Output name -> bound of its noise, in its unit. By default it is estimated from the periods of the record
        (99 % confidence for white Gaussian noise), which must repeat.
    domain
        ``"time"``: sample by sample (Poolla et al.). ``"frequency"``: line by line (Smith and Doyle), for blocks that
        are time-invariant systems, from whole periods of a record in steady state or from a `FrequencyData`.
    noise_norm
        ``"peak"``: bound of every sample; ``"rms"``: bound of the root mean square over the record. Default ``"peak"``
        in the time domain. In the frequency domain it is ``"rms"`` for a record (over the periods used), and a bound at
        each line for a frequency response, for which ``noise`` may hold one value for each line.
    at_rest
        The record starts at equilibrium. Otherwise the observable states are free at the start. Delta starts at zero
        state.
    window
        Cut the record into windows of that many seconds, each with a free initial state; the state of Delta continues.
        A weaker test, for records over which an open-loop response drifts.
    period
        Frequency domain: the period in s, if no recorded signal determines it.
    precision
        Relative width of the bounds to be reached.
    time_limit
        In s. If it is reached, the result has status TIMEOUT and depends on the machine. None: no limit.
    progress
        Called with one line at each step.
    effort
        Work that the search may take, as a multiple of the usual (about two minutes); counted, not timed.

    Returns
    -------
    Validation
        With both bounds, the Delta and the noise that explain the record, and the certificate of the lower bound.

        ============================  =======================================  =====================================
        blocks                        upper bound                              lower bound
        ============================  =======================================  =====================================
        frequency domain              w by cone programmes, loop closed again  multipliers, re-checked line by line
        time-varying                  w by convex-concave procedure, replayed  multipliers, re-checked by a sweep
        constant                      values by descent, replayed              of time-varying ones, in discrete time
        constant and dynamic          constants at nominal                     of time-varying ones, in discrete time
        none                          0 where noise alone explains the record  infinite elsewhere, weights re-checked
        ============================  =======================================  =====================================

    Raises
    ------
    InputError
        Signals that do not fit, an output without a noise bound, blocks that a domain cannot judge.
    NoTrustworthyNumber
        Irregular sampling, a noise bound of zero, a record that is not steady, no noise bound and no repeats to take it
        from, a solver that gives no answer.

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
    budget, estimated = search_budget("validate", WORK, effort, time_limit), noise is None
    require_linear_set("validate", uncertain)
    for block in uncertain.blocks:
        if block.is_real and not block.interval:
            found = f"a {type(block).__name__}"
            raise InputError(f"validate: block {block.name!r}", found, "real scalars, complex and full blocks")
    if not 1e-4 <= precision <= 0.2:
        raise InputError("validate", f"precision {precision:g}", "between 1e-4 and 0.2")
    if domain not in ("time", "frequency"):
        raise InputError("validate", f"domain {domain!r}", "'time' or 'frequency'")
    report = progress or (lambda _line: None)
    search = Search(precision, budget)
    if domain == "frequency" or isinstance(record, FrequencyData):
        fits_frequency_domain(record, domain, noise_norm, window, at_rest, noise)
        with one_thread():
            if isinstance(record, Record):
                noise = noise if noise is not None else _estimated(uncertain, record, "rms")
            return validate_by_lines(uncertain, record, noise or {}, search, period, report, estimated)
    if period is not None:
        raise InputError("validate", f"period {period:g} s", "a period only in the frequency domain")
    norm: NoiseNorm = noise_norm or "peak"
    with one_thread():
        bounds = noise if noise is not None else _estimated(uncertain, record, norm)
        recorded = prepared(uncertain, record, bounds, norm=norm, window=window, at_rest=at_rest)
        return validate_by_samples(record, recorded, search, report, estimated)


def _estimated(uncertain: UncertainModel, record: Record, norm: NoiseNorm) -> dict[str, float]:
    """Estimate noise bounds from the periods of the record."""
    from scipy import stats

    names = [s.name for s in uncertain.outputs if s.name in record.outputs]
    try:
        floor = noise_floor(record, outputs=names)
    except NoTrustworthyNumber as error:
        hint = "noise={'" + (names[0] if names else "y") + "': ...}, in its unit: the error bound of the sensor"
        raise NoTrustworthyNumber(
            f"validate {record.name}", f"no noise bound was given, and none can be estimated: {error.found}", None, hint
        ) from None
    count = record.n * max(len(names), 1)
    if norm == "peak":
        factor = float(stats.norm.isf((1 - CONFIDENCE) / (2 * count)))
    else:
        factor = float(np.sqrt(stats.chi2.ppf(CONFIDENCE ** (1 / max(len(names), 1)), record.n) / record.n))
    return {name: factor * floor.std[name] for name in names}
