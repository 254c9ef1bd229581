"""What drives a response: a uniform clock and the samples of every input."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from robustlab.errors import InputError, did_you_mean
from robustlab.record import UNIFORM_TOLERANCE
from robustlab.statespace import Signal, StateSpaceModel, real_array

__all__ = ["Excitation", "default_clock", "excitation"]

Array = NDArray[np.float64]

# A discrete model's clock may differ from its sample time by this share.
SAMPLE_TIME_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Excitation:
    """Times ``t (n_t,)`` in s, their step ``h``, and input samples ``u (n_t, n_u)``."""

    t: Array
    h: float
    u: Array


def excitation(
    inputs: Sequence[Signal], dt: float, t: ArrayLike, u: Mapping[str, ArrayLike] | ArrayLike | None, where: str
) -> Excitation:
    """The clock and the inputs as arrays.

    Parameters
    ----------
    inputs, dt
        Inputs and sample time of the models that are driven.
    t
        Times in s, shape (n_t,), with one step; for a discrete model its ``dt``.
    u
        Name -> number or samples (n_t,), inputs left out are zero; or an array (n_t,) for a single input, or
        (n_t, n_u); None for a unit step on the only input.

    Raises
    ------
    InputError
        A clock that is not uniform, unknown inputs, wrong lengths, several inputs and no ``u``.
    """
    clock = real_array("t", t, 1, where)
    if len(clock) < 2:
        raise InputError(where, f"t has {len(clock)} samples", "at least 2")
    step = np.diff(clock)
    h = float((clock[-1] - clock[0]) / len(step))
    if h <= 0 or np.abs(step - h).max() > UNIFORM_TOLERANCE * h:
        raise InputError(where, "t is not uniform", "increasing times with one step", "use numpy.linspace(0, t_end, n)")
    if dt and abs(h - dt) > SAMPLE_TIME_TOLERANCE * dt:
        raise InputError(where, f"t has a step of {h:.9g} s", f"the discrete model's sample time {dt:.9g} s")
    return Excitation(clock, h, _samples(inputs, len(clock), u, where))


def _samples(inputs: Sequence[Signal], n: int, u: Mapping[str, ArrayLike] | ArrayLike | None, where: str) -> Array:
    names = [s.name for s in inputs]
    if u is None:
        if len(names) != 1:
            hint = f"say which input steps: u={{{names[0]!r}: 1.0}}" if names else None
            raise InputError(where, f"{len(names)} inputs and no u", "one input, or u", hint)
        return np.ones((n, 1))
    if isinstance(u, Mapping):
        samples = np.zeros((n, len(names)))
        for key, value in u.items():
            if key not in names:
                known = ", ".join(names) or "none"
                raise InputError(
                    f"{where}: input {key!r}", "no such input", f"one of {known}", did_you_mean(str(key), names)
                )
            samples[:, names.index(key)] = _column(f"{where}: {key}", value, n)
        return samples
    shape = np.shape(u)
    if len(shape) == 2:
        array = real_array("u", u, 2, where)
        if array.shape != (n, len(names)):
            raise InputError(where, f"u has shape {array.shape}", f"{(n, len(names))}")
        return array
    if len(names) != 1:
        raise InputError(where, f"u has shape {shape}", f"{(n, len(names))}, or a dict of name -> samples")
    return _column(where, u, n)[:, None]


def _column(where: str, value: Any, n: int) -> Array:
    if np.ndim(value) == 0:
        return np.repeat(real_array("u", [value], 1, where), n)
    column = real_array("u", value, 1, where)
    if len(column) != n:
        raise InputError(where, f"u has {len(column)} samples", f"{n} to match t")
    return column


def default_clock(model: StateSpaceModel, where: str, n: int = 401) -> Array:
    """A clock over eight time constants of the slowest decay, shape (n,); integrators do not count.

    Raises
    ------
    InputError
        The model is unstable: how long to look is the user's to say.
    """
    poles = model.poles()
    if model.is_discrete:
        poles = np.log(np.where(np.abs(poles) > 1e-12, poles, 1e-12)) / model.dt
    size = float(np.abs(poles).max(initial=0.0))
    rate = poles.real[np.abs(poles) > 1e-9 * size]
    if (rate > 1e-9 * size).any():
        raise InputError(
            where, "the nominal model is unstable and no times are given", "t", "pass t=numpy.linspace(0, t_end, n)"
        )
    decay = -rate[rate < -1e-9 * size]
    duration = 8.0 / float(decay.min()) if len(decay) else (8.0 * 2 * np.pi / size if size else 1.0)
    if model.is_discrete:
        n, step = max(2, min(round(duration / model.dt) + 1, 5000)), model.dt
    else:
        step = duration / (n - 1)
    return real_array("t", step * np.arange(n), 1, where)
