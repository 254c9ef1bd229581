"""Draw images/flagship.png from a run folder, by default that of `robustlab run flagship --out out/flagship`."""

import json
import sys
from pathlib import Path

from robustlab.report.style import COLOURS, house_style, logarithmic, new_figure

RUN = Path(sys.argv[1] if len(sys.argv) > 1 else "out/flagship")
numbers = {s["name"]: s["numbers"] for s in json.loads((RUN / "result.json").read_text(encoding="utf-8"))["steps"]}


def of(step: str, key: str) -> float:
    """A number of the controller of `before` or `after`."""
    return numbers[f"proved_{step}" if key == "mu_upper" else "referee"]["controllers"][step][key]


panels = {
    "1  Free run, record held out: error [% of range]": (
        numbers["naming"]["free_run"]["before"],
        numbers["naming"]["free_run"]["after"],
    ),
    "2  Unmodelled dynamics needed [% of the input]": (
        100 * numbers["set_before"]["held_out"],
        100 * numbers["set_after"]["held_out"],
    ),
    "3  Proved for all members: mu (1: requirement met)": (
        of("before", "mu_upper"),
        of("after", "mu_upper"),
    ),
    "4  Tracking error of a simulated machine [mm]": (of("before", "worst_error"), of("after", "worst_error")),
}
figure, axes = new_figure(2, 2, width=11.0, height=2.2)
with house_style():
    for ax, (title, pair) in zip(axes, panels.items(), strict=True):
        for k, (value, colour) in enumerate(zip(pair, (COLOURS["worst"], COLOURS["nominal"]), strict=True)):
            ax.barh(k, value, color=colour, height=0.6)
            ax.annotate(f"{value:.3g}", (value, k), (5, 0), textcoords="offset points", va="center")
        logarithmic(ax.xaxis)
        ax.set(yticks=[0, 1], yticklabels=["before", "after naming"], ylim=(1.6, -0.6))
        ax.set_xlim(min(pair) / 3, 4 * max(pair))
        ax.set_title(title, loc="left")
figure.savefig(Path(__file__).parent / "images" / "flagship.png", dpi=110)
