"""The text of a comparison for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from robustlab.identification.comparison import Comparison

__all__ = ["summary"]


def summary(c: Comparison) -> str:
    """A dozen lines: sizes of the gap, where it lives, what the residual tests say, warnings."""
    lines = [
        f"{c.model} against {c.record}: {c.measured.n} samples, {c.measured.duration:.4g} s; "
        f"windows of {c.window:.4g} s; percent of the measured range"
    ]
    for name in c.outputs:
        lines += ["", *_gap_lines(c, name), *_place_lines(c, name), *_residual_lines(c, name)]
    if c.warnings:
        lines += ["", *(f"warning: {text}" for text in c.warnings)]
    return "\n".join(lines)


def _gap_lines(c: Comparison, name: str) -> list[str]:
    g = c.outputs[name]
    unit = f" {g.unit}" if g.unit else ""
    return [
        f"{name}: range {g.range:.4g}{unit}",
        f"  free run   peak {g.peak:.4g}{unit} ({g.peak_percent:.3g} %) at {g.peak_time:.4g} s, "
        f"rms {g.rms:.4g}{unit} ({g.rms_percent:.3g} %), fit {g.fit:.2f} %",
        f"  windowed   peak {g.windowed_peak:.4g}{unit} ({g.windowed_peak_percent:.3g} %), "
        f"rms {g.windowed_rms:.4g}{unit} ({g.windowed_rms_percent:.3g} %), fit {g.windowed_fit:.2f} %",
    ]


def _place_lines(c: Comparison, name: str) -> list[str]:
    w, s = c.windows[name], c.frequency[name]
    lines = [
        f"  time       worst window {w.start[w.worst]:.4g} to {w.stop[w.worst]:.4g} s holds "
        f"{100 * w.windowed_share[w.worst]:.1f} % of the windowed squared error "
        f"({100 / len(w.start):.1f} % if spread evenly)"
    ]
    if name in c.speed:
        b = c.speed[name]
        rest = len(b) // 2
        parts = (b[:rest], b[rest : rest + 1], b[rest + 1 :])
        texts = [
            f"{word} {100 * sum(x.share for x in part):.0f} %"
            for word, part in zip(("backward", "rest", "forward"), parts, strict=True)
        ]
        worst = max(b, key=lambda x: x.rms)
        lines.append(
            f"  speed      windowed squared error: {', '.join(texts)}; largest rms {worst.rms:.3g} {c.outputs[name].unit} "
            f"at {worst.low:.3g} to {worst.high:.3g} {c.motion.speed_unit}"
        )
    top, local = int(s.error_share.argmax()), int(s.windowed_share.argmax())
    lines.append(
        f"  frequency  free run {100 * s.error_share[top]:.0f} % in {s.bands[top]:.3g} to {s.bands[top + 1]:.3g} Hz, "
        f"windowed {100 * s.windowed_share[local]:.0f} % in {s.bands[local]:.3g} to {s.bands[local + 1]:.3g} Hz"
    )
    return lines


def _residual_lines(c: Comparison, name: str) -> list[str]:
    r = c.residual[name]
    w = r.whiteness
    lines = [
        f"  residual   one-step rms {r.rms:.3g} {c.outputs[name].unit}; {_verdict(w.p_value, 'white', 'not white')} "
        f"(Ljung-Box {w.statistic:.4g}, {w.dof} lags, p {_p(w.p_value)}); "
        f"{100 * w.predictable_share:.1f} % of its variance is predictable from its past"
    ]
    for u, test in r.inputs.items():
        lines.append(
            f"  input {u:<5}{_verdict(test.p_value, 'independent of the residual', 'still in the residual')} "
            f"(statistic {test.statistic:.4g}, {test.dof} degrees, p {_p(test.p_value)}); "
            f"it explains {100 * test.explained_share:.1f} % of the variance; "
            f"largest correlation {np.abs(test.correlation).max():.3f} (99 % band {test.band:.3f})"
        )
    return lines


def _verdict(p_value: float, accepted: str, rejected: str) -> str:
    return accepted if p_value >= 0.01 else rejected


def _p(p_value: float) -> str:
    return f"{p_value:.2g}" if p_value > 1e-6 else "< 1e-6"
