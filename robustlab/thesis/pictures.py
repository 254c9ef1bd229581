"""The thesis' figures redrawn from our runs, each with what it shows and which figure of the thesis it stands for."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from robustlab.dynamics.simulation import simulate
from robustlab.dynamics.stewart import condition_map, inverse_kinematics, stewart_platform
from robustlab.report.drawings import Picture
from robustlab.thesis.figures import (
    case_figure,
    condition_figure,
    excitation_figure,
    sine_figure,
    tracking_effort_figure,
    tracking_error_figure,
    tracking_path_figure,
)
from robustlab.thesis.numbers import PublishedNumbers
from robustlab.thesis.runs import UP_TO, Case
from robustlab.uncertainty.elementwise import elementwise
from robustlab.worst_case_analysis.sampling import sample

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
