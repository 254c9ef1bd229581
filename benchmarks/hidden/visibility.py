"""How far a hidden effect stands out of the noise: ``PYTHONPATH=benchmarks python -m hidden.visibility``.

The gap is that between the machine and the same machine without its effects, for the record's input. Angles are cut
into windows of 0.4 s, from each of which the answers to a start angle and to a start speed are taken (both are free in
any fit); currents are taken as they are. A noise sd is the RMS of what noise and disturbance do to the same windows.
"""

from __future__ import annotations

import sys
from dataclasses import astuple, dataclass

import numpy as np

from .cases import Case, make_case
from .families import FAMILIES
from .machine import Array, simulate

__all__ = ["Gap", "Refit", "gap", "refit"]

WINDOW = 0.4
SEEDS = range(900, 905)


@dataclass(frozen=True)
class Gap:
    """Gaps in noise sds.

    Attributes
    ----------
    run
        RMS over the whole record as it is, in sds of the whole record's noise (which drifts with the disturbance).
    windows
        RMS over the windows.
    peak
        Largest gap in a window.
    """

    run: float
    windows: float
    peak: float


@dataclass(frozen=True)
class Refit:
    """What a refit of the nominal parameters, each held near its value by its tolerance, makes of the gap.

    Attributes
    ----------
    rest
        RMS over the windows of what they cannot take over, in noise sds.
    cost
        What it asks of the tolerances: root of the summed squares of the shifts, in their sds.
    """

    rest: float
    cost: float


def gap(case: Case) -> Gap:
    """Gap of the case's record; over the clearer output where there are two."""
    bare = case.rig.channels(case.rig.clean(case.drive, effects=False), case.current)
    found = []
    for name, truth in case.record_clean.items():
        noise, missed = case.record[name] - truth, truth - bare[name]
        scaled = _windows(missed, case, name) / _rms(_windows(noise, case, name))
        found.append(Gap(_rms(missed) / _rms(noise), _rms(scaled), float(np.abs(scaled).max())))
    return max(found, key=lambda g: g.windows)


def refit(case: Case) -> Refit:
    """Linear refit of the nominal parameters to the gap, over all measured outputs together."""
    u = case.drive.samples
    bare = case.rig.channels(case.rig.clean(case.drive, effects=False), case.current)
    gaps, slopes = [], []
    for name, truth in case.record_clean.items():
        scale = _rms(_windows(case.record[name] - truth, case, name))
        gaps.append(_windows(truth - bare[name], case, name) / scale)
        slopes.append(_windows(_sensitivities(case, u, name), case, name) / scale)
    missed, slope = np.concatenate(gaps), np.concatenate(slopes)
    m = slope.shape[1]
    shift = np.linalg.lstsq(np.vstack([slope, np.eye(m)]), np.concatenate([missed, np.zeros(m)]), rcond=None)[0]
    return Refit(_rms(missed - slope @ shift), float(np.linalg.norm(shift)))


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


def main(family: str = "motor", noise: str = "mid", excitation: str = "rich", hold: str = "held") -> None:
    """Print a line per class: median and smallest of seeds that no test uses."""
    kind = FAMILIES[family]
    names = ("none", *kind.classes, *kind.outside, *kind.pairs)
    print(f"{family}, {noise} noise, {excitation}, {hold}; gaps in noise sd: median (smallest) of {SEEDS}")
    print(
        f"{'':44}", *(f"{head:>18}" for head in ("whole record", "windows", "peak", "rest of refit", "cost of refit"))
    )
    for name in names:
        rows = []
        for seed in SEEDS:
            case = make_case(
                name, seed, plant=kind.plant, noise=noise, excitation=excitation, current=kind.current, hold=hold
            )  # fmt: skip
            rows.append([*astuple(gap(case)), *astuple(refit(case))])
        cells = [f"{np.median(column):9.3g} ({min(column):.3g})".rjust(18) for column in zip(*rows, strict=True)]
        print(f"{name if isinstance(name, str) else ' + '.join(name):44}", *cells, flush=True)


if __name__ == "__main__":
    main(*sys.argv[1:])
