"""Figures of the Stewart platform: excitation, linear against nonlinear, perturbed models, the controlled machine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from robustlab.arrays import Array
from robustlab.dynamics.control.platform import MOST_TORQUE, MOST_VOLTAGE, TrajectoryFollowing
from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart import condition_map, inverse_kinematics, stewart_platform
from robustlab.dynamics.stewart.kinematics import ConditionMap
from robustlab.report.drawings import Picture
from robustlab.report.style import COLOURS, house_style, new_figure, plain_label
from robustlab.thesis.numbers import PublishedNumbers
from robustlab.thesis.runs import UP_TO, Case, SineRun
from robustlab.uncertainty.elementwise import elementwise
from robustlab.worst_case_analysis.sampling import sample

# Six lines in one panel: colours of Okabe and Ito, the second three dashed, so that they are told apart in grey too.
SIX = [("#0072B2", "-"), ("#D55E00", "-"), ("#009E73", "-"), ("#56B4E9", "--"), ("#E69F00", "--"), ("#CC79A7", "--")]
# Curves that lie on one another: wide, dashed and thin, dotted and thinner.
THREE = [("#56B4E9", "-"), ("#D55E00", (0, (4, 3))), ("#222222", ":")]


def condition_figure(maps: Sequence[ConditionMap]) -> Figure:
    """Condition number of the Jacobian over two coordinates of the pose each; white is out of the workspace."""
    figure, panels = new_figure(1, len(maps), width=5.0 * len(maps), height=4.0)
    lowest = min(float(np.nanmin(m.condition)) for m in maps)
    highest = max(float(np.nanmax(m.condition)) for m in maps)
    image = None
    with house_style():
        for axes, found in zip(panels, maps, strict=True):
            first, second = 1e3 * found.first, 1e3 * found.second
            edges = (first[0], first[-1], second[0], second[-1])
            image = axes.imshow(
                found.condition.T,
                origin="lower",
                extent=edges,
                aspect="auto",
                vmin=lowest,
                vmax=highest,
                cmap="viridis",
            )
            labels = [f"{name} [{'mm' if name.startswith('t') else 'mrad'}]" for name in found.names]
            axes.set(xlabel=labels[0], ylabel=labels[1])
            axes.grid(visible=False)
        if image is not None:
            figure.colorbar(image, ax=panels, label="condition number of the Jacobian")
    return figure


def excitation_figure(run: SineRun, until: float) -> Figure:
    """What drives the machine up to the time ``until`` in s, and where it goes: torque of every motor, height."""
    figure, (drive, height) = new_figure(1, 2, width=9.0, height=3.2)
    shown = run.t <= until
    t = run.t[shown]
    with house_style():
        torque = 1e3 * run.amplitude * np.sin(2 * np.pi * run.frequency * t)
        drive.plot(t, torque, color=COLOURS["nominal"])
        drive.set(xlabel="time [s]", ylabel="torque of each motor [mN m]")
        height.plot(t, 1e3 * run.height[shown], color=COLOURS["nominal"], label="nonlinear, simulated")
        height.axhline(140.7, color=COLOURS["worst"], ls=(0, (5, 2)), lw=1.3, label="thesis: 140.7 mm")
        height.set(xlabel="time [s]", ylabel="height of the platform [mm]")
        height.legend()
    return figure


def sine_figure(run: SineRun, until: float) -> Figure:
    """Nut 1 up to the time ``until`` in s: angle and rate, nonlinear and linear, and the difference in percent."""
    figure, (angle, rate, gap) = new_figure(1, 3, width=10.8, height=3.3)
    t, angle_gap, rate_gap = run.percent(until)
    n = len(t)
    with house_style():
        for axes, column, label in ((angle, 0, "nut angle [rad]"), (rate, 6, "nut rate [rad/s]")):
            axes.plot(t, run.nonlinear[:n, column], color=COLOURS["nominal"], lw=2.4, label="nonlinear")
            axes.plot(t, run.linear[:n, column], color=COLOURS["worst"], ls=(0, (4, 2)), label="linear, at home")
            axes.set(xlabel="time [s]", ylabel=label)
        gap.plot(t, angle_gap, color=COLOURS["nominal"], label="angle")
        gap.plot(t, rate_gap, color=COLOURS["worst"], ls=(0, (4, 2)), label="rate")
        gap.set(xlabel="time [s]", ylabel="linear minus nonlinear [%]")
        for axes in (angle, gap):
            axes.legend()
    return figure


def percent_figure(t: Array, bands: Mapping[str, Array], published: float) -> Figure:
    """Members' deviations from the nominal response in percent, (members, n) of each output, and the published band."""
    figure, panels = new_figure(1, len(bands), width=10.4, height=3.3)
    with house_style():
        for axes, (name, curves) in zip(panels, bands.items(), strict=True):
            low, high = curves.min(axis=0), curves.max(axis=0)
            axes.fill_between(t, low, high, color=COLOURS["band"], alpha=0.25, lw=0, label="all members")
            for i, curve in enumerate(curves):
                axes.plot(t, curve, color=COLOURS["sample"], lw=0.6, label="member" if i == 0 else None)
            for i, edge in enumerate((-published, published)):
                label = f"thesis: ±{published:g} %" if i == 0 else None
                axes.axhline(edge, color=COLOURS["worst"], ls=(0, (5, 2)), lw=1.3, label=label)
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
    """Nominal, worst member and random members in one picture, a row for each output.

    ``t``: times in s, shape (n_t,). ``members``, ``nominal``, ``worst``: responses, shapes (n_members, n_t, n_y), (n_t,
    n_y), (n_t, n_y). ``outputs``: names and units, n_y of them. ``published``: published band of the change in percent.
    ``title``: what is drawn, with the worst Delta.
    """
    figure, panels = new_figure(len(outputs), 3, width=11.6, height=2.7)
    before = 1e3 * (t - t[-1])
    label = f"{len(members)} random members"
    with house_style():
        for k, (name, unit) in enumerate(outputs):
            whole, end, change = panels[3 * k : 3 * k + 3]
            scale = 100 / np.abs(nominal[:, k]).max()
            for i, member in enumerate(members[:, :, k]):
                for axes, x in ((whole, t), (end, before)):
                    axes.plot(x, member, color=COLOURS["sample"], lw=0.6, label=None if i else label)
                change.plot(t, scale * (member - nominal[:, k]), color=COLOURS["sample"], lw=0.6)
            for curve, key, dashes, word in (
                (nominal[:, k], "nominal", "-", "nominal"),
                (worst[:, k], "worst", (0, (4, 2)), "worst Δ"),
            ):
                for axes, x in ((whole, t), (end, before)):
                    axes.plot(x, curve, color=COLOURS[key], ls=dashes, lw=1.3, label=word)
                change.plot(t, scale * (curve - nominal[:, k]), color=COLOURS[key], ls=dashes, lw=1.3)
            for i, edge in enumerate((-published, published)):
                told = f"thesis: ±{published:g} %" if i == 0 else None
                change.axhline(edge, color=COLOURS["reference"], ls=":", lw=1.2, label=told)
            # So near to the end that the members are apart by a fair share of what the nominal response runs through.
            final, slope = nominal[-1, k], (nominal[-1, k] - nominal[-2, k]) / (before[-1] - before[-2])
            spread = np.abs(np.append(members[:, -1, k], worst[-1, k]) - final).max()
            window = min(6 * spread / max(abs(slope), 1e-300), -before[0])
            edges = sorted((final - slope * window, final))
            end.xaxis.set_major_locator(MaxNLocator(3))
            end.set_xlim(-window, 0.0)
            end.set_ylim(edges[0] - 1.2 * spread, edges[1] + 1.2 * spread)
            whole.set_ylabel(plain_label(f"{name} [{unit}]"))
            change.set_ylabel("minus nominal [%]")
        panels[0].set_title("response")
        panels[1].set_title("its end, enlarged")
        panels[2].set_title("change, % of largest nominal")
        for axes, text in zip(panels[-3:], ("time [s]", "time before the end [ms]", "time [s]"), strict=True):
            axes.set_xlabel(text)
        figure.suptitle(plain_label(title), x=0.01, ha="left", fontsize=10.5, fontweight="bold")
        (lines, words), (edges, bands) = (axes.get_legend_handles_labels() for axes in (panels[0], panels[2]))
        figure.legend([*lines, *edges], [*words, *bands], loc="outside lower center", ncols=4)
    return figure


def tracking_path_figure(run: TrajectoryFollowing, lengths: Array) -> Figure:
    """Desired and reached: position, orientation, and the actuators' lengths (``lengths`` (n, 6) in m are desired)."""
    figure, panels = new_figure(3, 1, width=9.4, height=2.4, sharex=True)
    home = run.reference[0]
    shown = (
        (1e3 * (run.reference - home)[:, :3], 1e3 * (run.pose - home)[:, :3], "from home [mm]", ("x", "y", "z")),
        (1e3 * run.reference[:, 3:], 1e3 * run.pose[:, 3:], "orientation [mrad]", ("about x", "about y", "about z")),
        (1e3 * lengths, 1e3 * run.lengths, "actuator length [mm]", tuple(f"link {i + 1}" for i in range(6))),
    )
    with house_style():
        for axes, (desired, reached, label, names) in zip(panels, shown, strict=True):
            for i, (name, (colour, dashes)) in enumerate(zip(names, SIX if len(names) > 3 else THREE, strict=True)):
                axes.plot(run.t, desired[:, i], color=colour, lw=4.0, alpha=0.3)
                axes.plot(run.t, reached[:, i], color=colour, ls=dashes, lw=1.2, label=name)
            axes.set_ylabel(label)
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        panels[0].set_title("wide and pale: desired; thin: reached, simulated", fontweight="normal", fontsize=8.5)
        panels[-1].set_xlabel("time [s]")
    return figure


def tracking_error_figure(run: TrajectoryFollowing) -> Figure:
    """Errors of position and orientation over time."""
    figure, (position, angle) = new_figure(2, 1, width=8.4, height=2.6, sharex=True)
    with house_style():
        panels = (
            (position, 1e3 * run.error[:, :3], "position error [mm]", ("x", "y", "z")),
            (angle, 1e3 * run.error[:, 3:], "orientation error [mrad]", ("about x", "about y", "about z")),
        )
        for axes, values, label, names in panels:
            for column, name, (colour, dashes), width in zip(values.T, names, THREE, (4.0, 2.4, 1.4), strict=True):
                axes.plot(run.t, column, color=colour, ls=dashes, lw=width, label=name)
            axes.set_ylabel(label)
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
        angle.set_xlabel("time [s]")
    return figure


def tracking_effort_figure(run: TrajectoryFollowing) -> Figure:
    """Torques and voltages of the six motors with their limits, and lengths of the actuators."""
    figure, panels = new_figure(3, 1, width=8.4, height=2.3, sharex=True)
    shown = (
        (1e3 * run.torque, "torque [mN m]", 1e3 * MOST_TORQUE),
        (run.voltage, "voltage [V]", MOST_VOLTAGE),
        (1e3 * run.lengths, "length [mm]", None),
    )
    with house_style():
        for axes, (values, label, limit) in zip(panels, shown, strict=True):
            for i, (column, (colour, dashes)) in enumerate(zip(values.T, SIX, strict=True)):
                axes.plot(run.t, column, color=colour, ls=dashes, lw=1.2, label=f"link {i + 1}")
            axes.set_ylabel(label)
            if limit is not None and np.abs(values).max() > 0.4 * limit:  # a far limit would flatten the curves
                for i, edge in enumerate((-limit, limit)):
                    axes.axhline(edge, color=COLOURS["reference"], ls=":", lw=1.3, label=None if i else "motor's limit")
            elif limit is not None:
                axes.set_title(
                    f"the motor's limit of {limit:g} is beyond this panel", fontsize=8.5, fontweight="normal"
                )
        lines = {text: line for axes in panels for line, text in zip(*axes.get_legend_handles_labels(), strict=True)}
        panels[0].legend(lines.values(), lines, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        panels[-1].set_xlabel("time [s]")
    return figure


SIGNS = {"thesis": "all signs +", "link-4": "signs +++-+-", "rotors": "all signs +, with the rotors' inertia"}


def pictures_of_numbers(found: PublishedNumbers) -> Iterator[tuple[str, Picture]]:
    """Pictures by name: poses near singular ones, the sine runs, and the runs of section 9.1.3."""
    geometry = stewart_platform().geometry
    side, tilt = np.linspace(-0.025, 0.025, 101), np.linspace(-0.15, 0.15, 101)
    maps = [condition_map(geometry, ("tx", "ty"), side, side), condition_map(geometry, ("ax", "ay"), tilt, tilt)]
    words = "How near poses about home are to a singular one; white is out of the workspace (6.2.1)."
    yield "condition", Picture(condition_figure(maps), words)
    for name, run in found.sines.items():
        until = run.when_height(0.1407) if name == "0.1 N m at 2 Hz" else run.t[-1]
        words = (
            f"{name} on all motors: the torque, and the platform's height, simulated (figures 8.1, 8.2; how long they "
            "last is not printed)."
        )
        yield f"height-{name}", Picture(excitation_figure(run, until), words)
        words = (
            f"{name} on all motors: the nonlinear simulation, the linear model at home, and their difference (figures "
            "8.3-8.6)."
        )
        yield f"sine-{name}", Picture(sine_figure(run, until), words)
    for name, run in found.tracking.items():
        lengths, where = inverse_kinematics(geometry, run.reference), f"Section 9.1.3, {SIGNS[name]}"
        words = (
            f"{where}: desired and reached position, orientation and actuator lengths (figures 9.3-9.5). What is "
            "called measured there is simulated here."
        )
        yield f"path-{name}", Picture(tracking_path_figure(run, lengths), words)
        yield f"error-{name}", Picture(tracking_error_figure(run), f"{where}: errors of the pose.")
        words = f"{where}: torques, voltages, lengths of the actuators."
        yield f"effort-{name}", Picture(tracking_effort_figure(run), words)


def case_picture(case: Case, n: int, seed: int) -> tuple[Picture, dict[str, float]]:
    """Nominal, worst and ``n`` random members of a case; largest change in percent of each output at the worst."""
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
