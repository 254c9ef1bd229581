"""Simulation: linear models exactly at the samples, nonlinear plants with error control."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.arrays import Array
from robustlab.checks import number
from robustlab.delays.model import DelayedModel, delayed_response
from robustlab.dynamics.plant_base import NonlinearHold, NonlinearPlant, Plant, SteppedPlant, input_signal
from robustlab.errors import InputError, NoTrustworthyNumber, error_context, unknown_name
from robustlab.record import Record
from robustlab.statespace import Signal, StateSpaceModel, as_model, real_array

# Steps that differ by less than this share of their mean are equal. Larger: fewer matrix exponentials, but real jitter
# is ignored.
CLOCK_ROUNDING = 1e-9
# Allowed jitter of the times of a discrete model or a plant with effects, as a share of the sample time.
CLOCK_JITTER = 1e-6
# Default local error of a nonlinear simulation.
RTOL = 1e-8

Hold = Literal["zoh", "foh"]
LOOK = 3  # Padé order for the default duration of a step response


@error_context("simulate")
def simulate(
    plant_or_model: Any,
    t: ArrayLike,
    u: Mapping[str, ArrayLike] | ArrayLike,
    x0: ArrayLike | None = None,
    *,
    name: str | None = None,
    hold: NonlinearHold = "zoh",
    rtol: float | None = None,
    step: float | None = None,
) -> Record:
    r"""Simulate a plant or model under given inputs.

    The solution of a linear one,

    .. math:: x(t_{k+1}) = e^{A h_k} x(t_k) + \int_0^{h_k} e^{A (h_k - s)} B\, u(t_k + s)\, ds

    is evaluated by matrix exponentials, without discretisation error. A discrete model (dt > 0) is stepped. A nonlinear
    plant is integrated by DOP853 with local error ``rtol``. A plant with effects (`with_effects`) is stepped with its
    forces held, on equal steps, with exact sticking. A model with exact delays is solved by the method of steps
    (`robustlab.delays.model`): without error where the delays are at inputs and outputs, else with an estimated
    error below ``rtol``. Its delays are empty before ``t[0]``.

    Parameters
    ----------
    plant_or_model
        A plant, a StateSpaceModel, a DelayedModel, or a ``control.StateSpace``; of an uncertain model the nominal one.
    t
        Times in s, shape (n,), strictly increasing; the steps may differ (for a discrete model they are its dt).
    u
        Name of input -> samples of shape (n,), for every input; or an array (n,) for a single input, or (n, n_u).
    x0
        State at t[0], shape (n_x,); default zero, for a functional mock-up unit its own. States that effects have added
        start at zero and may be omitted.
    name
        Name of the record; default: that of the plant, or "simulation".
    hold
        Input between samples: "zoh" holds the last value (a D/A converter), "foh" interpolates linearly (a sampled
        smooth signal); "spline" (nonlinear plants only) interpolates smoothly and is fastest for a smooth signal.
    rtol
        Nonlinear plants: relative local error of a step, default 1e-8. Models with internal delays: largest change when
        the cells are halved, relative to the largest output, default 1e-9.
    step
        Plants with effects: longest step, default 1 ms; for a nonlinear plant, steps are then halved until the states
        change by no more than 1e-4 of their size.

    Returns
    -------
    Record
        Inputs and all outputs with their units; in deviations if the model has an operating point.

    Raises
    ------
    InputError
        Unknown or missing inputs, wrong lengths, NaN, decreasing times, or times that do not match the discrete model.
    NoTrustworthyNumber
        The response exceeds double precision, or a mechanism leaves its workspace; the message names the time. The
        response of a model with delays does not converge to ``rtol``, or needs too many cells.

    Examples
    --------
    >>> lag = StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]])
    >>> simulate(lag, [0.0, 1.0, 2.0], [1.0, 1.0, 1.0])["y1"].round(6)
    array([0.      , 0.632121, 0.864665])
    """
    if isinstance(plant_or_model, NonlinearPlant):
        return _simulate_nonlinear(plant_or_model, t, u, x0, hold, rtol, step, name)
    if isinstance(plant_or_model, Plant) and not hasattr(plant_or_model, "to_model"):
        raise InputError("simulate", f"{plant_or_model.name} is not linear", "a linear plant or a model")
    delayed = isinstance(plant_or_model, DelayedModel)
    if delayed and step is not None:
        raise InputError("simulate", "step for a model with delays", "rtol: its cells are halved until that is met")
    if not delayed and (rtol is not None or step is not None):
        raise InputError("simulate", "rtol or step for a linear model", "neither: it is simulated without error")
    model = plant_or_model if isinstance(plant_or_model, DelayedModel) else as_model(plant_or_model, "simulate")
    title = name or getattr(plant_or_model, "name", None) or "simulation"
    clock = Record(t, name="simulate").t
    force = sampled_inputs(model.inputs, u, len(clock))
    inner = model.H if isinstance(model, DelayedModel) else model
    start = np.zeros(inner.n_states) if x0 is None else real_array("x0", x0, 1, "simulate")
    if len(start) != inner.n_states:
        states = ", ".join(inner.state_names) or "none"
        raise InputError("simulate", f"x0 has {len(start)} entries", f"{inner.n_states} (states: {states})")
    if hold not in ("zoh", "foh"):
        raise InputError("simulate: hold", f"{hold!r} for a linear model", "'zoh' or 'foh'")
    with np.errstate(over="ignore", invalid="ignore"):
        if isinstance(model, DelayedModel):
            most = 1e-9 if rtol is None else rtol
            change = number("simulate: rtol", most, "a number between 0 and 1", above=0, below=1)
            x, y = np.zeros((len(clock), 0)), delayed_response(model, clock, force, start, hold, change)
        else:
            x = (_discrete_states if model.is_discrete else _states)(model, clock, force, start, hold)
            y = x @ model.C.T + force @ model.D.T
    _check_finite(np.hstack([x, y]), clock, title)
    return recorded(model, clock, force, y, title)


def default_clock(
    model: StateSpaceModel, where: str, n: int = 401, hint: str = "pass t=numpy.linspace(0, t_end, n)"
) -> Array:
    """Return times (n,) over eight time constants of the slowest decay, ignoring integrators."""
    poles = model.poles()
    if model.is_discrete:
        poles = np.log(np.where(np.abs(poles) > 1e-12, poles, 1e-12)) / model.dt
    size = float(np.abs(poles).max(initial=0.0))
    rate = poles.real[np.abs(poles) > 1e-9 * size]
    if (rate > 1e-9 * size).any():
        raise InputError(where, "the nominal model is unstable and no times are given", "t", hint)
    decay = -rate[rate < -1e-9 * size]
    duration = 8.0 / float(decay.min()) if len(decay) else (8.0 * 2 * np.pi / size if size else 1.0)
    if model.is_discrete:
        n, step = max(2, min(round(duration / model.dt) + 1, 5000)), model.dt
    else:
        step = duration / (n - 1)
    return real_array("t", step * np.arange(n), 1, where)


def step_response(model: Any, t_end: float | None, input_name: str | None) -> Record:
    """Return the result of ``G.step()``, see `robustlab.operators.Behaviour`."""
    given = model if isinstance(model, DelayedModel) else as_model(model, "step")
    names = given.input_names
    if input_name is None and len(names) != 1:
        hint = f'G.step(input="{names[0]}")' if names else None
        raise InputError("step", f"inputs {', '.join(names) or 'none'}", "the name of the one that steps", hint)
    if input_name is not None and input_name not in names:
        raise unknown_name(f"step: input {input_name!r}", "no such input", str(input_name), names)
    rational = given.pade(LOOK) if isinstance(given, DelayedModel) else given
    if t_end is None:
        clock = default_clock(rational, "step", hint="give the duration in s: G.step(t_end=1.0)")
    elif isinstance(t_end, bool) or not isinstance(t_end, (int, float, np.number)) or not 0 < t_end < np.inf:
        raise InputError("step: t_end", f"{t_end!r}", "a positive time in s")
    elif given.is_discrete:
        clock = given.dt * np.arange(max(round(t_end / given.dt), 1) + 1)
    else:
        clock = np.linspace(0.0, t_end, 401)
    return simulate(
        given, clock, {name: np.full(len(clock), float(name == (input_name or names[0]))) for name in names}
    )


def _simulate_nonlinear(
    plant: NonlinearPlant, t: Any, u: Any, x0: Any, hold: Any, rtol: float | None, step: float | None, name: str | None
) -> Record:
    clock = Record(t, name="simulate").t
    samples = sampled_inputs(plant.inputs, u, len(clock))
    signal = input_signal(clock, samples, hold)
    start = plant.start if x0 is None else real_array("x0", getattr(x0, "x", x0), 1, "simulate")
    if isinstance(plant, SteppedPlant):
        start = plant.whole_state(start)
    start, _ = plant.point(start, np.zeros(len(plant.inputs)))
    for key, value in (("rtol", rtol), ("step", step)):
        if value is not None:
            number(f"simulate: {key}", value, "a number between 0 and 1", above=0, below=1)
    if isinstance(plant, SteppedPlant):
        if hold != "zoh":
            expected = "'zoh': its steps hold the input"
            raise InputError("simulate: hold", f"{hold!r} for a plant that steps itself", expected)
        if rtol is not None:
            raise InputError("simulate", "rtol for a plant that steps itself", "step: its steps have no error control")
        force = samples
        x, y = plant.stepped(clock, force, start, step)
    else:
        if step is not None:
            raise InputError("simulate", f"step for {plant.name}", "rtol: it is integrated with error control")
        force = signal.samples
        x = plant.trajectory(signal, start, rtol=RTOL if rtol is None else rtol)
        y = plant.outputs_along(x, force)
    _check_finite(np.hstack([x, y]), clock, plant.name)
    return recorded(plant, clock, force, y, name or plant.name)


def transition(model: StateSpaceModel, h: float) -> tuple[Array, Array, Array]:
    """Return ``(Phi, Gamma, Gamma1)`` of one step of length h in s of a continuous model."""
    # Van Loan, "Computing integrals involving the matrix exponential", IEEE TAC 23 (1978).
    from scipy.linalg import expm, matrix_balance

    n, n_u = model.n_states, model.n_inputs
    if n == 0:
        return np.zeros((0, 0)), np.zeros((0, n_u)), np.zeros((0, n_u))
    # Powers of two for states and inputs: the exponential's squarings amplify the rounding of a badly scaled matrix.
    balanced, (scale, _) = matrix_balance(model.A, permute=False, separate=True)
    b = model.B / scale[:, None]
    size = np.abs(b).max(axis=0, initial=0.0)
    column = np.asarray(np.exp2(np.round(np.log2(np.where(size > 0, size, 1.0)))), dtype=np.float64)
    block = np.zeros((n + 2 * n_u, n + 2 * n_u))
    block[:n, :n] = balanced * h
    block[:n, n : n + n_u] = b / column * h
    block[n : n + n_u, n + n_u :] = np.eye(n_u)
    with np.errstate(over="ignore", invalid="ignore"):  # an unstable model may overflow
        e = np.asarray(expm(block)[:n], dtype=np.float64)
    if not np.isfinite(e).all() and model.is_stable():
        fastest = float(np.abs(model.poles()).max())
        found = f"rates up to {fastest:.3g} 1/s in a step of {h:.3g} s: the exponential overflows on its way"
        raise NoTrustworthyNumber("simulate", found, None, "shorter steps, or a model without its fastest states")
    phi = scale[:, None] * e[:, :n] / scale
    gamma, gamma1 = scale[:, None] * e[:, n : n + n_u] * column, scale[:, None] * e[:, n + n_u :] * column
    return phi, gamma, gamma1


def _states(model: StateSpaceModel, t: Array, u: Array, x0: Array, hold: Hold) -> Array:
    """Return states (n, n_x) of a continuous model at the times t; one matrix exponential for each step length."""
    step = np.diff(t)
    mean = step.mean()
    _, first, kind = np.unique(np.round(step / (CLOCK_ROUNDING * mean)), return_index=True, return_inverse=True)
    length = np.bincount(kind, weights=step) / np.bincount(kind)
    phi = np.empty((len(first), model.n_states, model.n_states))
    forced = np.empty((len(step), model.n_states))
    order = np.argsort(kind, kind="stable")
    bounds = np.searchsorted(kind[order], np.arange(len(first) + 1))
    for j, h in enumerate(length):
        phi[j], gamma, gamma1 = transition(model, float(h))
        k = order[bounds[j] : bounds[j + 1]]
        forced[k] = u[k] @ gamma.T
        if hold == "foh":
            forced[k] += (u[k + 1] - u[k]) @ gamma1.T
    return _recursion(phi, kind, forced, x0)


def _discrete_states(model: StateSpaceModel, t: Array, u: Array, x0: Array, hold: Hold) -> Array:
    if hold == "foh":
        expected = "'zoh': a discrete model sees the samples only"
        raise InputError("simulate: hold", "'foh' for a discrete model", expected)
    step = np.diff(t)
    wrong = np.abs(step - model.dt) > CLOCK_JITTER * model.dt
    if wrong.any():
        k, expected = int(np.argmax(wrong)), f"the discrete model's sample time {model.dt:.9g} s"
        raise InputError("simulate", f"t[{k + 1}] - t[{k}] = {step[k]:.9g} s", expected)
    return _recursion(model.A[None], np.zeros(len(step), dtype=np.intp), u[:-1] @ model.B.T, x0)


def _recursion(phi: Array, kind: NDArray[np.intp], forced: Array, x0: Array) -> Array:
    """Return ``x[k+1] = phi[kind[k]] x[k] + forced[k]``, shape (n, n_x)."""
    x = np.empty((len(forced) + 1, len(x0)))
    x[0] = x0
    state = x0
    for k, j in enumerate(kind.tolist()):
        state = phi[j].dot(state) + forced[k]
        x[k + 1] = state
    return x


def sampled_inputs(inputs: tuple[Signal, ...], u: Mapping[str, ArrayLike] | ArrayLike, n: int) -> Array:
    """Return the inputs' samples as an array (n, n_u) in their order."""
    names, count = tuple(s.name for s in inputs), len(inputs)
    if isinstance(u, Mapping):
        for key in u:
            if key not in names:
                raise unknown_name(f"simulate: input {key!r}", "no such input", str(key), names)
        missing = [key for key in names if key not in u]
        if missing:
            raise InputError("simulate", f"no samples for input {', '.join(missing)}", "samples for every input")
        columns = [real_array(key, u[key], 1, "simulate") for key in names]
        for key, column in zip(names, columns, strict=True):
            if len(column) != n:
                raise InputError(f"simulate: {key}", f"{len(column)} samples", f"{n} to match t")
        return np.column_stack(columns) if columns else np.zeros((n, 0))
    try:
        ndim = 1 if np.ndim(u) == 1 else 2
    except ValueError:  # ragged: real_array raises the error
        ndim = 2
    samples = real_array("u", u, ndim, "simulate")
    if samples.ndim == 1 and count == 1:
        samples = samples.reshape(-1, 1)
    if samples.shape != (n, count):
        hint = f"the inputs are {', '.join(names)}; a dict of name -> samples leaves no doubt about their order"
        raise InputError("simulate", f"u has shape {samples.shape}", f"{(n, count)}", hint)
    return samples


def recorded(plant: Plant | StateSpaceModel | DelayedModel, t: Array, u: Array, y: Array, name: str) -> Record:
    """Return inputs (n, n_u) and outputs (n, n_y) of a plant or model as a record with their units."""
    inputs, outputs = (
        {s.name: column for s, column in zip(signals, samples.T, strict=True)}
        for signals, samples in ((plant.inputs, u), (plant.outputs, y))
    )
    return Record(t, inputs, outputs, {s.name: s.unit for s in (*plant.inputs, *plant.outputs)}, name)


def _check_finite(values: Array, t: Array, where: str) -> None:
    bad = ~np.isfinite(values).all(axis=1)
    if bad.any():
        k = int(np.argmax(bad))
        found = f"the response outgrows double precision at t = {t[k]:.9g} s (sample {k})"
        hint = "the model is unstable: simulate a shorter time, or close a loop around it"
        raise NoTrustworthyNumber(where, found, None, hint)
