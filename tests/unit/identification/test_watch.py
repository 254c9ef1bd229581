"""Watching a log of an axis whose dry friction rises, simulated exactly between its switches."""

import json
import math

import numpy as np
import pytest
from scipy.stats import binom

import robustlab as rl
from robustlab.cli import main_guard, run_command

J, B, FC, DT, NOISE = 2e-3, 4e-3, 0.02, 5e-3, 5e-3
UNITS = {"u": "N m", "q": "rad"}
FEW = ("coulomb-friction", "constant-load", "quadratic-drag", "sensor-delay", "input-dead-zone")


def advance(q, w, push, f, left):
    """State of J w' = push - B w - f sgn w, q' = w after ``left`` seconds: exponentials between stops."""
    while left > 0.0:
        if w == 0.0 and abs(push) <= f:
            return q, 0.0
        way = math.copysign(1.0, w or push)
        end, stops = (push - f * way) / B, math.inf
        if w != 0.0 and end * way < 0.0:
            stops = J / B * math.log(1.0 - w / end)
        span = min(left, stops)
        fade = math.exp(-B * span / J)
        q += end * span + (w - end) * J / B * (1.0 - fade)
        w = 0.0 if stops <= left else end + (w - end) * fade
        left -= span
    return q, w


def log(seed, seconds=16.0, friction=lambda t: FC, push=lambda t: 0.0, fine=1):
    """A record of the axis under random steps."""
    rng = np.random.default_rng(seed)
    t = DT * np.arange(round(seconds / DT))
    u, k, q, w = np.zeros(len(t)), 0, 0.0, 0.0
    while k < len(t):
        span = int(rng.integers(20, 80))
        u[k : k + span] = rng.uniform(-0.1, 0.1)
        k += span
    y = np.empty(len(t))
    for k, at in enumerate(t):
        y[k] = q
        for part in range(fine):
            q, w = advance(q, w, u[k] + push(at + (part + 0.5) * DT / fine), friction(at), DT / fine)
    return rl.Record(t, {"u": u}, {"q": y + NOISE * rng.normal(size=len(t))}, UNITS, f"log {seed}")


def bare(inertia=J, viscous=B):
    states = [("q", "rad"), ("w", "rad/s")]
    a, b = [[0.0, 1.0], [0.0, -viscous / inertia]], [[0.0], [1.0 / inertia]]
    return rl.StateSpaceModel(a, b, [[1, 0]], [[0]], inputs=[("u", "N m")], outputs=[("q", "rad")], states=states)


def axis():
    return rl.with_effects(bare(), {"coulomb-friction": {"Fc": FC}})


def others():
    """Ids of the catalogue but those: a short list is searched quickly."""
    from robustlab.dynamics import catalogue

    return sorted(set(catalogue()) - set(FEW))


def wear(t):
    """Friction that rises by 30 % from 6 s to 16 s."""
    return FC * (1.0 + 0.3 * min(max(t - 6.0, 0.0) / 10.0, 1.0))


@pytest.fixture(scope="module")
def worn():
    return rl.watch(axis(), log(2, friction=wear), every=2.0, noise={"q": NOISE}, exclude=others())


@pytest.mark.slow
def test_wear_raises_an_alarm_and_the_pieces_since_have_the_larger_friction(worn):
    assert (worn.verdict, worn.met) == ("changed", False)
    assert 6.0 < worn.alarm <= 12.0
    assert worn.since_lower <= 6.0 <= worn.since_upper or worn.since - 6.0 <= 2.0
    assert "coulomb-friction" in worn.found.names
    level = next(e for e in worn.found.effects if e.name == "coulomb-friction").parameters[0].value
    assert wear(worn.since) < level < wear(16.0)
    assert "no longer explains the log since" in worn.headline()


@pytest.mark.slow
def test_an_unknown_effect_raises_an_alarm():
    wave = lambda t: 4e-3 * math.sin(14.0 * t + 3.0 * math.sin(5.0 * t)) if t >= 6.0 else 0.0  # noqa: E731
    found = rl.watch(axis(), log(3, push=wave, fine=10), every=2.0, noise={"q": NOISE}, exclude=others())
    assert (found.verdict, found.alarm > 6.0) == ("changed", True)
    assert found.found is None or not found.found.complete


@pytest.mark.slow
def test_an_effect_that_the_model_lacks_is_identified():
    load = lambda t: -4e-3 if t >= 8.0 else 0.0  # noqa: E731
    found = rl.watch(axis(), log(5, push=load), every=2.0, noise={"q": NOISE}, exclude=others())
    assert found.verdict == "changed"
    assert {"coulomb-friction", "constant-load"} <= set(found.found.names)
    load = next(e for e in found.found.effects if e.name == "constant-load").parameters[0]
    assert load.lower <= 4e-3 <= load.upper
    assert found.since_lower <= 8.0 <= found.since_upper


@pytest.mark.slow
def test_alarms_where_nothing_changes_are_as_rare_as_stated():
    alarms = sum(
        not rl.watch(axis(), log(100 + k, 5.0), every=1.0, noise={"q": NOISE}, false_alarm=0.02, exclude=others()).met
        for k in range(200)
    )
    assert alarms <= binom.ppf(0.999, 200, 0.02)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({}, "at least two"),
        ({"every": 0.0}, "every"),
        ({"every": 2.0, "false_alarm": 1.0}, "between 0 and 1"),
        ({"every": 2.0, "noise": {"w": 1.0}}, "noise: 'w'"),
        ({"every": 2.0, "noise": {"q": -1.0}}, "above 0"),
        ({"every": 2.0, "noise": {}}, "none of 'q'"),
        ({"every": 2.0, "exclude": ["coulomb"]}, "coulomb"),
        ({"every": 0.1}, "at least"),
    ],
)
def test_invalid_options_are_refused(given, message):
    with pytest.raises(rl.InputError, match=message):
        rl.watch(axis(), log(1, 6.0), **{"noise": {"q": NOISE}, **given})


def test_pieces_of_another_kind_are_refused():
    short = log(1, 2.0)
    fast = rl.Record(0.5 * short.t + 10.0, short.inputs, short.outputs, UNITS)
    blind = rl.Record(short.t + 10.0, {"u": short["u"], "v": short["q"]}, {"x": short["q"]}, {"u": "N m"})
    for other, message in ((fast, "sample time"), (blind, "no output 'q'"), ("log", "records")):
        with pytest.raises(rl.InputError, match=message):
            rl.watch(axis(), [short, other], noise={"q": NOISE}, exclude=others())


def run(tmp_path, record, capsys, *more):
    rl.save(tmp_path / "axis.h5", axis())
    rows = np.column_stack([record.t, record["u"], record["q"]])
    np.savetxt(tmp_path / "log.csv", rows, delimiter=",", header="t,u,q", comments="")
    words = f"--every 2 --noise q={NOISE} --inputs u --outputs q --unit q=rad --unit".split()
    words.append("u=N m")
    left_out = [word for name in others() for word in ("--exclude", name)]
    arguments = ["watch", str(tmp_path / "axis.h5"), str(tmp_path / "log.csv"), *words, *left_out, *more]
    code = main_guard(lambda: run_command(["data", *arguments]))
    return code, capsys.readouterr()


@pytest.mark.slow
def test_the_command_ends_in_1_with_an_alarm_and_in_0_without(tmp_path, capsys):
    code, printed = run(tmp_path, log(2, friction=wear), capsys, "--json")
    result = json.loads(printed.out)
    assert (code, result["verdict"], "coulomb-friction" in result["found"]["names"]) == (1, "changed", True)
    assert len(result["pieces"]) == 8
    assert "ALARM: piece" in printed.err
    code, printed = run(tmp_path, log(1, 6.0), capsys)
    assert code == 0
    assert "explains all of the log, 3 pieces" in printed.out
