"""Where integrals and covers of the frequency axis are cut: finer towards the frequency of every pole."""

from __future__ import annotations

import numpy as np

from robustlab.arrays import AnyArray

# Panels next to a pole end where another pole is nearer by this factor: that one's panels are as fine there.
NEARER = 1.5


def panel_ends(poles: AnyArray, dt: float, growth: float) -> AnyArray:
    """Ends of the first panels in rad/s: from 0 to the Nyquist frequency, or to W and then one more step for the rest.

    Poles are those of the s-plane, also for ``dt > 0``. Next to one at a distance r from the axis, panels end at r, r
    times ``growth``, r times its square ...
    """
    nyquist = np.pi / dt if dt else 0.0
    poles = np.unique(np.real(poles) + 1j * np.abs(np.imag(poles)))
    last = nyquist or 4.0 * float(np.abs(poles).max())
    at, width = np.imag(poles), np.maximum(np.abs(np.real(poles)), np.maximum(np.spacing(np.abs(poles)), 1e-25 * last))
    steps = np.ceil(np.log(max(last / width.min(initial=last), 1.0)) / np.log(growth)) + 1
    away = np.append(0.0, growth ** np.arange(steps)) * width[:, None]
    own = np.hypot(away, width[:, None])
    ends, own = np.concatenate([at[:, None] + away, at[:, None] - away]), np.concatenate([own, own])
    inside = (ends > 0) & (ends < last)
    ends, own = ends[inside], own[inside]
    nearest = np.abs(1j * ends[:, None] - poles).min(axis=1, initial=np.inf)  # the conjugate ones are further away
    ends = np.unique(np.concatenate([[0.0, last], ends[own <= NEARER * nearest]]))
    return ends if nyquist else np.append(ends, 2 * last)
