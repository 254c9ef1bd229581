"""``robustlab mu``: robust stability margin of an uncertain model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from robustlab.cli.console import JsonOption, OutOption, SeedOption, emit, note, table
from robustlab.errors import InputError

if TYPE_CHECKING:
    from robustlab.mu_analysis import Margin

app = typer.Typer(pretty_exceptions_enable=False, rich_markup_mode=None, add_completion=False)


@app.command()
def mu(
    file: Annotated[str, typer.Argument(help="HDF5 file with an uncertain model.")],
    accuracy: Annotated[float, typer.Option(help="Relative distance to the best margin that D, G can prove.")] = 1e-3,
    timeout: Annotated[float, typer.Option(help="Seconds after which the proof over the axis is given up.")] = 60.0,
    intervals: Annotated[bool, typer.Option("--intervals", help="Print the proved frequency intervals.")] = False,
    figure: Annotated[
        str | None, typer.Option(help="Figure to write, as NAME.svg and NAME.png.", show_default=False)
    ] = None,
    seed: SeedOption = 0,
    out: OutOption = None,
    as_json: JsonOption = False,
) -> None:
    """Robust stability margin (1 / mu) over the whole frequency axis, with the critical Delta.

    Example: robustlab mu motor-uncertain.h5 --intervals --out margin.h5
    """
    from robustlab.mu_analysis import robust_stability
    from robustlab.storage import load
    from robustlab.uncertainty.lft import UncertainModel

    if not 0 < accuracy < 1 or not timeout > 0:
        raise InputError("mu", f"accuracy {accuracy}, timeout {timeout}", "0 < accuracy < 1 and a positive timeout")
    uncertain = load(file)
    if not isinstance(uncertain, UncertainModel):
        raise InputError(
            file, f"a {type(uncertain).__name__}", "an uncertain model", "robustlab uncertain build --help"
        )
    margin = robust_stability(uncertain, accuracy=accuracy, time_limit=timeout, seed=seed)
    if out is not None:
        from robustlab.storage import save

        save(out, margin)
        note(f"written: {out}")
    if figure is not None:
        _draw(margin, figure)
        note(f"written: {figure}")
    emit("mu", margin.to_json(), _text(margin, intervals), as_json)
    if not margin.status.trustworthy:
        raise typer.Exit(4)


def _text(margin: Margin, with_intervals: bool) -> str:
    """The margin as a reader wants it: bounds, what is critical, what is proved."""
    lines = [
        f"robust stability margin  {margin.lower:.6g} .. {margin.upper:.6g}  ({margin.status})",
        f"peak of mu               {_inverse(margin.upper):.6g} .. {_inverse(margin.lower):.6g}",
    ]
    if margin.frequency is not None:
        lines += [f"critical frequency       {margin.frequency:.6g} rad/s", "", "critical Delta (smallest found):"]
        rows = [(name, _number(value), _physical(margin, name)) for name, value in margin.delta.items()]
        lines.append(table(rows, ("block", "delta", "parameter")))
    lines += [f"note: {text}" for text in margin.notes]
    if with_intervals:
        rows = [(f"{low:.6g}", f"{high:.6g}", f"{bound:.6g}") for low, high, bound in sorted(margin.intervals)]
        lines += ["", "proved intervals:", table(rows, ("from rad/s", "to rad/s", "mu at most"))]
        lines += [f"not proved: {low:.6g} .. {high:.6g} rad/s" for low, high in margin.open]
    return "\n".join(lines)


def _inverse(value: float) -> float:
    return 1 / value if value else float("inf")


def _number(value: Any) -> str:
    shape = getattr(value, "shape", ())
    if shape:
        return f"{shape[0]} x {shape[1]} matrix"
    return f"{value:+.6g}"


def _physical(margin: Margin, name: str) -> str:
    if name not in margin.physical:
        return ""
    value, unit = margin.physical[name]
    return f"{value:.6g} {unit}".rstrip()


def _draw(margin: Margin, path: str) -> None:
    from pathlib import Path

    from robustlab.report.figures import save_figure
    from robustlab.report.mu_figures import mu_figure

    target = Path(path)
    drawing = mu_figure(margin.omega, margin.mu_lower, margin.mu_upper, margin.intervals, margin.frequency)
    save_figure(drawing, target.parent, target.stem)
