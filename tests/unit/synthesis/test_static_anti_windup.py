"""Static anti-windup: proved gains against simulations, closed forms, and what is refused."""

from __future__ import annotations

import math
import subprocess

import numpy as np
import pytest

import robustlab as rl
from robustlab.errors import InputError, NoTrustworthyNumber
from robustlab.result import Status

LAG = rl.StateSpaceModel([[-0.1]], [[1.0]], [[1.0]], [[0.0]])
PI = rl.StateSpaceModel([[0.0]], [[-1.0]], [[2.0]], [[-3.0]])


@pytest.fixture(scope="module")
def found():
    return rl.anti_windup(LAG, PI)


def simulated(found, L, H, w, dt):
    """|z|_2 for w (n, k), held, by Runge and Kutta: plant and controller as they are, the saturation itself."""
    P, K = LAG, found.controller

    def parts(x, value):
        y = P.C @ x[:1]
        seen = y + value
        uc = K.C @ x[1:] + K.D @ seen
        if H.any():  # u_c = v + H (sat(u_c) - u_c) of one output: piecewise linear
            v, h = uc, float(H[0, 0])
            inside = np.abs(v) <= 1
            uc = np.where(inside, v, (v + h * np.sign(v)) / (1 + h))
        u = np.clip(uc, -1, 1)
        return np.vstack([P.A @ x[:1] + P.B @ u, K.A @ x[1:] + K.B @ seen + L @ (u - uc)]), seen

    x, square = np.zeros((2, w.shape[1])), np.zeros(w.shape[1])
    for value in w:
        value = value[None]
        k1, begun = parts(x, value)
        k2, _ = parts(x + 0.5 * dt * k1, value)
        k3, _ = parts(x + 0.5 * dt * k2, value)
        k4, _ = parts(x + dt * k3, value)
        x = x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        ended = (P.C @ x[:1] + value)[0]
        square += dt / 6 * (begun[0] ** 2 + 4 * (0.5 * (begun[0] + ended)) ** 2 + ended**2)
    return np.sqrt(square)


def references(t):
    """Pulses, sines, and references that reverse, of several sizes; they end at zero."""
    shapes = [np.where(t < end, 1.0, 0.0) for end in (2.0, 6.0, 15.0, 40.0)]
    shapes += [np.sin(w * t) for w in (0.05, 0.1, 0.2, 0.5, 1.0)]
    shapes += [np.sign(np.sin(w * t)) for w in (0.05, 0.1, 0.2, 0.5, 1.0)]
    shapes = np.array(shapes).T * (t < 60)[:, None]
    return np.hstack([size * shapes for size in (0.3, 3.0, 9.0, 11.0, 30.0)])


@pytest.mark.parametrize("kind", ["found", "direct", "back"])
def test_no_reference_reaches_more_than_the_proved_gain(found, kind):
    if kind == "direct":
        found = rl.anti_windup(LAG, PI, direct=True)
    dt = 0.02
    t = np.arange(0.0, 150.0, dt)
    w = references(t)
    L, H, proved = found.L, found.H, found.proved
    if kind == "back":
        from robustlab.synthesis.windup.static_anti_windup import _calculated

        L, proved = _calculated(PI, [(-1.0, 1.0)], found.time), found.back
    worst = (simulated(found, L, H, w, dt) / (np.sqrt(dt) * np.linalg.norm(w, axis=0))).max()
    assert proved.status is Status.CERTIFIED
    assert 0.9 <= worst <= proved.upper


def test_the_gain_is_proved_apart_from_the_synthesis(found):
    assert found.status is Status.CERTIFIED
    assert found.proved.upper < found.level  # dynamic multipliers beat the quadratic function of the synthesis
    assert found.linear <= found.proved.upper < found.back.upper
    # cut off, the integrator is free: no gain without anti-windup
    assert found.without.status is Status.INFEASIBLE
    static = rl.peak_gain(
        rl.StateSpaceModel(*_by_hand(found)),
        natures={("uc", "q"): rl.Nonlinearity((0.0, 1.0), steady=False)},
        outputs=["z"],
    )
    # the circle criterion of the loop built by hand is the inequality that was solved
    assert static.upper == pytest.approx(found.level, rel=0.03)


def _by_hand(found):
    """[q, w] to [uc, z]: x' = -0.1 x + uc - q, xc' = -(x + w) - L q, uc = 2 xc - 3 (x + w), z = x + w."""
    L = float(found.L[0, 0])
    A = [[-0.1 - 3.0, 2.0], [-1.0, 0.0]]
    B = [[-1.0, -3.0], [-L, -1.0]]
    return A, B, [[-3.0, 2.0], [1.0, 0.0]], [[0.0, -3.0], [0.0, 1.0]], 0.0, ["q", "w"], ["uc", "z"]


def test_an_integrating_plant_needs_a_reach():
    plant = rl.StateSpaceModel([[0.0, 1.0], [0.0, -1.0]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    pid = rl.StateSpaceModel([[0.0, 0.0], [0.0, -20.0]], [[-1.0], [-1.0]], [[1.0, -600.0]], [[-32.0]])
    with pytest.raises(NoTrustworthyNumber, match="no static gain was found"):
        rl.anti_windup(plant, pid)
    found = rl.anti_windup(plant, pid, reach=3.0)
    assert found.status is Status.CERTIFIED
    assert found.proved.upper < found.without.upper
    assert found.proved.conditions == ("uc1:q1: while it stays within 3 times its limit",)


def test_the_channel_of_a_generalised_plant_is_kept():
    wide = rl.StateSpaceModel([[-0.1]], [[0.5, 1.0]], [[2.0], [1.0]], [[0.0, 0.0], [0.0, 0.0]])
    found = rl.anti_windup(wide, PI)
    loop = rl.StateSpaceModel([[-3.1, 2.0], [-1.0, 0.0]], [[0.5], [0.0]], [[2.0, 0.0]], [[0.0]])
    assert found.linear == pytest.approx(rl.peak_gain(loop).upper, rel=1e-6)
    assert found.proved.upper >= found.linear


def test_the_held_controller_goes_into_c(found, tmp_path):
    dt = 0.05
    held, L = found.sampled(dt)
    path = rl.export_controller(tmp_path / "k.c", held, saturation=(-1.0, 1.0), anti_windup=L)
    text = path.read_text()
    assert "L was given" in text
    main = '#include <stdio.h>\n#include "k.c"\nint main(void){controller_state s; controller_init(&s);'
    main += "double u[1], y[1]; for (int i = 0; i < 40; i++) { u[0] = i < 20 ? -2.0 : 0.1; controller_step(&s, u, y);"
    main += ' printf("%.17g\\n", y[0]); } return 0; }\n'
    (tmp_path / "main.c").write_text(main)
    subprocess.run(["cc", "-std=c99", "-o", tmp_path / "main", tmp_path / "main.c", "-lm"], check=True)
    printed = [
        float(line) for line in subprocess.run([tmp_path / "main"], capture_output=True, check=True).stdout.split()
    ]
    x, expected = 0.0, []
    for i in range(40):
        y = -2.0 if i < 20 else 0.1
        uc = 2 * x - 3 * y
        u = min(max(uc, -1.0), 1.0)
        expected.append(u)
        x += dt * (-y + found.L[0, 0] * (u - uc))  # an integrator held is a sum
    assert printed == pytest.approx(expected, abs=1e-9)
    with pytest.raises(InputError, match=r"a gain of \(1, 2\)"):
        rl.export_controller(tmp_path / "k.c", held, saturation=(-1.0, 1.0), anti_windup=[[1.0, 2.0]])


@pytest.mark.parametrize(
    ("ask", "kind", "text"),
    [
        (lambda: rl.anti_windup(LAG, PI, limits=(0.5, 1.0)), InputError, "low < 0 < high"),
        (lambda: rl.anti_windup(LAG, PI, reach=0.5), InputError, "more than 1"),
        (lambda: rl.anti_windup(LAG, PI, limits="ab"), InputError, "low < 0 < high"),
        (lambda: rl.anti_windup(LAG, PI, time=0.0), InputError, "a positive number of seconds"),
        (
            lambda: rl.anti_windup(*(rl.StateSpaceModel([], [], [], [[k]]) for k in (1.0, -1.0))),
            InputError,
            "without states",
        ),
        (lambda: rl.anti_windup(rl.discretise(LAG, 0.1), PI), InputError, "a discrete model"),
        (lambda: rl.anti_windup(LAG, rl.StateSpaceModel([], [], [], [[1.0]])), NoTrustworthyNumber, "unstable without"),
        (lambda: rl.anti_windup(LAG, rl.StateSpaceModel([], [], [], [[-1.0, 0.0]])), InputError, "at least as many"),
        (lambda: rl.anti_windup(LAG, PI, direct=True).sampled(0.1), InputError, "an algebraic loop"),
    ],
)
def test_what_does_not_fit_is_refused(ask, kind, text):
    with pytest.raises(kind, match=text) as error:
        ask()
    assert "\n" not in error.value.line


def test_a_gain_for_one_side_only_is_for_all(found):
    wide = rl.anti_windup(LAG, PI, limits=[(-1.0, 3.0)])
    assert wide.status is Status.CERTIFIED
    assert wide.proved.upper >= found.proved.upper * 0.999  # a law that is not odd has fewer multipliers
    assert math.isfinite(wide.proved.upper)
