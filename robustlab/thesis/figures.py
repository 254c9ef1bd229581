"""Figures of the Stewart platform: excitation, linear against nonlinear, perturbed models, the controlled machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from robustlab.arrays import Array
from robustlab.dynamics.control.platform import TrajectoryFollowing
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart.stewart_platform import inverse_kinematics, stewart_platform
from robustlab.report.drawings import Picture
from robustlab.report.style import COLOURS, house_style, new_figure, plain_label
from robustlab.thesis.numbers import UP_TO, Case, PublishedNumbers, SineRun, first_time
from robustlab.uncertainty.elementwise import elementwise
from robustlab.worst_case_analysis.sampling import sample

Curves = list[tuple[Array, dict[str, Any]]]  # values (n,), and how they are drawn

# Six lines in one panel: colours of Okabe and Ito, the second three dashed for prints in grey.
SIX = [("#0072B2", "-"), ("#D55E00", "-"), ("#009E73", "-"), ("#56B4E9", "--"), ("#E69F00", "--"), ("#CC79A7", "--")]
# Coincident curves: wide, dashed and thin, dotted and thinner.
THREE = [("#56B4E9", "-"), ("#D55E00", (0, (4, 3))), ("#222222", ":")]


def over_time(
    t: Array, panels: Sequence[tuple[str, Curves]], title: str = "", columns: int = 1, height: float = 2.4
) -> Figure:
    """Draw panels over time: label with unit, and curves (n,) with their style."""
    width = 9.4 if columns == 1 else 3.6 * columns
    figure, axes_list = new_figure(len(panels) // columns, columns, width=width, height=height, sharex=True)
    legend = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if columns == 1 else {}
    with house_style():
        for axes, (label, curves) in zip(axes_list, panels, strict=True):
            for values, look in curves:
                axes.plot(t, values, **look)
            axes.set_ylabel(label)
            if axes.get_legend_handles_labels()[1]:
                axes.legend(**legend)
        if title:
            axes_list[0].set_title(title, fontweight="normal", fontsize=8.5)
        for axes in axes_list[-columns:]:
            axes.set_xlabel("time [s]")
    return figure


def lines(values: Array, names: Sequence[str], scale: float = 1e3) -> Curves:
    """Return a curve for each column of the values (n, k), in units of 1/scale."""
    looks = zip(names, SIX if len(names) > 3 else THREE, strict=True)
    drawn = [{"color": colour, "ls": dashes, "lw": 1.2, "label": name} for name, (colour, dashes) in looks]
    return list(zip(scale * values.T, drawn, strict=True))


def sine_figure(run: SineRun, until: float) -> Figure:
    t, angle_gap, rate_gap = run.percent(until)
    n = len(t)
    torque = 1e3 * run.amplitude * np.sin(2 * np.pi * run.frequency * t)
    wide, thin = {"color": COLOURS["nominal"], "lw": 2.4}, {"color": COLOURS["worst"], "ls": (0, (4, 2))}
    both = [{**wide, "label": "nonlinear"}, {**thin, "label": "linear, at home"}]
    height = [(1e3 * run.height[:n], wide), (np.full(n, 140.7), {**thin, "label": "thesis: 140.7 mm"})]
    nut = [[(run.nonlinear[:n, c], both[0]), (run.linear[:n, c], both[1])] for c in (0, 6)]
    gaps = [(angle_gap, {**wide, "label": "angle"}), (rate_gap, {**thin, "label": "rate"})]
    panels: list[tuple[str, Curves]] = [
        ("torque of each motor [mN m]", [(torque, wide)]),
        ("height of the platform [mm]", height),
        ("linear minus nonlinear [%]", gaps),
        ("nut angle [rad]", nut[0]),
        ("nut rate [rad/s]", nut[1]),
        ("largest actuator length [mm]", [(1e3 * run.lengths[:n].max(axis=1), wide)]),
    ]
    return over_time(t, panels, columns=3, height=3.0)


def percent_figure(t: Array, bands: Mapping[str, Array], published: float) -> Figure:
    """Draw deviations of members from the nominal response in percent, (members, n) of each output, and the band."""
    figure, panels = new_figure(1, len(bands), width=10.4, height=3.3)
    with house_style():
        for axes, (name, curves) in zip(panels, bands.items(), strict=True):
            low, high = curves.min(axis=0), curves.max(axis=0)
            axes.fill_between(t, low, high, color=COLOURS["band"], alpha=0.25, lw=0, label="all members")
            for i, curve in enumerate(curves):
                axes.plot(t, curve, color=COLOURS["sample"], lw=0.6, label="member" if i == 0 else None)
            _published_band(axes, published, COLOURS["worst"])
            axes.set(xlabel="time [s]", ylabel=f"change of {plain_label(name)} [%]")
        panels[-1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return figure


def case_figure(
    t: Array,
    members: Array,
    nominal: Array,
    worst: Array,
    outputs: Sequence[tuple[str, str]],
    published: float,
    title: str,
) -> Figure:
    """Draw nominal, worst and random members (n_members, n_t, n_y), and the published band of the change in percent."""
    figure, panels = new_figure(len(outputs), 2, width=9.4, height=2.7)
    label = f"{len(members)} random members"
    with house_style():
        for k, (name, unit) in enumerate(outputs):
            whole, change = panels[2 * k : 2 * k + 2]
            scale = 100 / np.abs(nominal[:, k]).max()
            thin = [(member, "sample", "-", 0.6, None if i else label) for i, member in enumerate(members[:, :, k])]
            wide: list[Any] = [
                (nominal[:, k], "nominal", "-", 1.3, "nominal"),
                (worst[:, k], "worst", (0, (4, 2)), 1.3, "worst Δ"),
            ]
            for curve, key, dashes, width, word in [*thin, *wide]:
                for axes, y in ((whole, curve), (change, scale * (curve - nominal[:, k]))):
                    axes.plot(t, y, color=COLOURS[key], ls=dashes, lw=width, label=word)
            _published_band(change, published, COLOURS["reference"])
            whole.set_ylabel(plain_label(f"{name} [{unit}]"))
            change.set_ylabel("minus nominal [%]")
        for axes, words in zip(panels, ("response", "change, % of largest nominal"), strict=False):
            axes.set_title(words)
        for axes in panels[-2:]:
            axes.set_xlabel("time [s]")
        figure.suptitle(plain_label(title), x=0.01, ha="left", fontsize=10.5, fontweight="bold")
        figure.legend(*panels[1].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def _published_band(axes: Axes, published: float, colour: str) -> None:
    for edge, label in ((-published, f"thesis: ±{published:g} %"), (published, None)):
        axes.axhline(edge, color=colour, ls=(0, (5, 2)), lw=1.3, label=label)


LINKS = [f"link {i + 1}" for i in range(6)]


def tracking_path_figure(run: TrajectoryFollowing, lengths: Array) -> Figure:
    home = run.reference[0]
    rows = (
        ((run.reference - home)[:, :3], (run.pose - home)[:, :3], "from home [mm]", ["x", "y", "z"]),
        (run.reference[:, 3:], run.pose[:, 3:], "orientation [mrad]", ["about x", "about y", "about z"]),
        (lengths, run.lengths, "actuator length [mm]", LINKS),
    )
    panels: list[tuple[str, Curves]] = []
    for desired, reached, label, names in rows:
        pale = [(v, {"color": look["color"], "lw": 4.0, "alpha": 0.3}) for v, look in lines(desired, names)]
        panels.append((label, [*pale, *lines(reached, names)]))
    return over_time(run.t, panels, "wide and pale: desired; thin: reached, simulated")


def tracking_error_figure(run: TrajectoryFollowing) -> Figure:
    panels: list[tuple[str, Curves]] = [
        ("position error [mm]", lines(run.error[:, :3], ["x", "y", "z"])),
        ("orientation error [mrad]", lines(run.error[:, 3:], ["about x", "about y", "about z"])),
        ("torque [mN m]", lines(run.torque, LINKS)),
        ("voltage [V]", lines(run.voltage, LINKS, 1.0)),
    ]
    return over_time(run.t, panels)


SIGNS = {"thesis": "all signs +", "link-4": "signs +++-+-", "rotors": "all signs +, with the rotors' inertia"}


def pictures_of_numbers(found: PublishedNumbers) -> Iterator[tuple[str, Picture]]:
    """Yield pictures by name: the sine runs, and the runs of section 9.1.3."""
    geometry = stewart_platform().geometry
    for name, run in found.sines.items():
        until = first_time(run.t, run.height, 0.1407) if name == "0.1 N m at 2 Hz" else run.t[-1]
        words = (
            f"{name} on all motors: the torque and the platform's height, simulated (figures 8.1, 8.2; how long they "
            "last is not printed); the nonlinear simulation, the linear model at home, their difference (8.3-8.6)."
        )
        yield f"sine-{name}", Picture(sine_figure(run, until), words)
    for name, run in found.tracking.items():
        lengths, where = inverse_kinematics(geometry, run.reference), f"Section 9.1.3, {SIGNS[name]}"
        words = (
            f"{where}: desired and reached position, orientation and actuator lengths (figures 9.3-9.5). What is "
            "called measured there is simulated here."
        )
        yield f"path-{name}", Picture(tracking_path_figure(run, lengths), words)
        yield f"error-{name}", Picture(tracking_error_figure(run), f"{where}: errors of the pose, torques, voltages.")


def case_picture(case: Case, n: int, seed: int) -> tuple[Picture, dict[str, float]]:
    """Draw nominal, worst and ``n`` random members of a case; return also the largest changes in percent."""
    between = elementwise(*case.with_gravity(), "single").select(None, ["phi_1", "phidot_1"])
    t, u = case.excitation()
    responses = sample(between, n, seed, vertices=2).respond(t, u, hold="foh")
    record = simulate(between.evaluate({b.name: float(case.worst) for b in between.blocks}), t, u, hold="foh")
    worst = np.column_stack([record[name] for name, _ in responses.outputs])
    reading = "the holding torque stays nominal" if case.held else "each trimmed anew"
    words = (
        f"Case {case.name} ({case.words}): nominal, worst Δ and {n} random members, {reading}, simulated under 0.1 N m "
        f"at 2 Hz for {1e3 * UP_TO:.1f} ms; {case.worst_in_words} (figures 10.6-10.21)."
    )
    title = f"Case {case.name}, {case.words}: {case.worst_in_words.partition(' (')[0]}"
    figure = case_figure(t, responses.y[:n], responses.nominal, worst, responses.outputs, case.published, title)
    sizes = np.abs(responses.nominal).max(axis=0)
    changes = 100 * np.abs(worst - responses.nominal).max(axis=0) / sizes
    found = {name: float(change) for (name, _), change in zip(responses.outputs, changes, strict=True)}
    return Picture(figure, words), found
