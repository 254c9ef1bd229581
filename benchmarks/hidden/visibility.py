"""How far a hidden effect stands out of the noise: ``PYTHONPATH=benchmarks python -m hidden.visibility``.

The gap is that between the machine and the same machine without its effects, for the record's input. Angles are cut
into windows of 0.4 s, from each of which the answers to a start angle and to a start speed are taken (both are free in
any fit); currents are taken as they are. A noise sd is the RMS of what noise and disturbance do to the same windows.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass

import numpy as np

from .cases import CLASSES, CURRENT_ONLY, OUTSIDE, PAIRS, SERVO_CLASSES, SERVO_OUTSIDE, Case, make_case
from .machine import Array, simulate

__all__ = ["Visibility", "visibility"]

WINDOW = 0.4


@dataclass(frozen=True)
class Visibility:
    """Gaps in noise sds.

    Attributes
    ----------
    run
        RMS over the whole record as it is, in sds of the whole record's noise (which drifts with the disturbance).
    windows
        RMS over the windows.
    peak
        Largest gap in a window.
    refitted
        RMS over the windows of what the nominal parameters cannot take over: after a linear refit of them, each held
        near its value by its tolerance.
    cost
        What that refit asks of the tolerances: root of the summed squares of the shifts, in their sds.
    """

    run: float
    windows: float
    peak: float
    refitted: float
    cost: float


def visibility(case: Case) -> Visibility:
    """Gaps of the case's record, over all measured outputs together (RMS) or over the clearest one (peak)."""
    u = case.record["u"]
    bare = case.clean(u, effects=False)
    whole, gaps, peaks, slopes = [], [], [], []
    for name, truth in case.record_clean.items():
        noise = case.record[name] - truth
        scale = _rms(_windows(noise, case, name))
        gap = _windows(truth - bare[name], case, name) / scale
        whole.append(_rms(truth - bare[name]) / _rms(noise))
        gaps.append(gap)
        peaks.append(np.abs(gap).max())
        slopes.append(_windows(_sensitivities(case, u, name), case, name) / scale)
    gap, slope = np.concatenate(gaps), np.concatenate(slopes)
    m = slope.shape[1]
    shift = np.linalg.lstsq(np.vstack([slope, np.eye(m)]), np.concatenate([gap, np.zeros(m)]), rcond=None)[0]
    return Visibility(max(whole), _rms(gap), float(max(peaks)), _rms(gap - slope @ shift), float(np.linalg.norm(shift)))


def _rms(x: Array) -> float:
    return float(np.sqrt(np.mean(x**2)))


def _windows(x: Array, case: Case, name: str) -> Array:
    """Columns (n, m) or one (n,) without what a start angle and speed do in each window; a current stays as it is."""
    if name == "i":
        return x
    dt, decay = case.rig.dt, case.rig.bare
    rate = (decay.b_pos + (decay.Kt * decay.Ke / decay.R if decay.winding else 0.0)) / decay.J1
    width = round(WINDOW / dt)
    keep = len(x) // width * width
    cut = x[:keep].reshape(keep // width, width, -1)
    start = np.linalg.qr(np.column_stack([np.ones(width), np.exp(-rate * dt * np.arange(width))]))[0]
    free = np.einsum("ti,wtm->wim", start, cut)
    return (cut - np.einsum("ti,wim->wtm", start, free)).reshape(keep, *x.shape[1:])


def _sensitivities(case: Case, u: Array, name: str) -> Array:
    """Change of the output (n, m) per tolerance sd of each nominal parameter (uniform within its tolerance)."""
    setup, columns, step = case.rig.setup, [], 0.3
    true = {key: value * case.perturbed[key] for key, (value, _) in setup.nominal.items()}
    together = {key: group for group in setup.together for key in group}
    for key, (_, tolerance) in setup.nominal.items():
        group = together.get(key, (key,))
        if key != group[0]:
            continue
        sides = []
        for sign in (1.0, -1.0):
            moved = {k: v * (1 + sign * step * tolerance if k in group else 1.0) for k, v in true.items()}
            sides.append(case.rig.channels(simulate(setup.machine(moved), u, case.rig.dt), case.current)[name])
        columns.append((sides[0] - sides[1]) / (2 * step * np.sqrt(3)))
    return np.column_stack(columns)


def main(plant: str = "dc-motor", noise: str = "mid", excitation: str = "rich", sensors: str = "encoder") -> None:
    """Print a line per class: median and smallest of ten seeds that no test uses."""
    current, servo = sensors == "current", plant == "servo-axis"
    names = (*SERVO_CLASSES, *SERVO_OUTSIDE) if servo else (*CLASSES, *CURRENT_ONLY, *OUTSIDE, *PAIRS)
    print(f"{plant}, {noise} noise, {excitation}, {sensors}; gaps in noise sd: median (smallest)")
    print(f"{'':44} {'whole record':>18} {'windows':>18} {'peak':>18} {'after refit':>18} {'cost':>18}")
    for name in names:
        seen = [
            visibility(make_case(name, seed, plant=plant, noise=noise, excitation=excitation, current=current))
            for seed in range(900, 910)
        ]
        cells = []
        for figure in ("run", "windows", "peak", "refitted", "cost"):
            values = [getattr(s, figure) for s in seen]
            cells.append(f"{np.median(values):9.3g} ({min(values):.3g})".rjust(18))
        print(f"{name if isinstance(name, str) else ' + '.join(name):44}", *cells, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
