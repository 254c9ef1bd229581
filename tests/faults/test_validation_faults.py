"""``robustlab data validate`` on bad input: a status and exit code 4, never a number."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import main_guard, run_command

T = np.arange(60) * 0.05
U = np.sign(np.sin(2 * np.pi * T / 1.5 + 0.05))
LAG = rl.StateSpaceModel([[-2.0]], [[2.0]], [[1.0]], [[0.0]], 0.0, ["u"], ["y"])


@pytest.fixture
def call(tmp_path, capsys):
    """Run the command on a set and a record; NAME=VALUE bounds."""

    def run(model, record, *options, bound="y=0.02"):
        rl.save(tmp_path / "set.h5", model)
        if isinstance(record, rl.Record):
            rl.save(tmp_path / "run.h5", record)
            record = tmp_path / "run.h5"
        arguments = ["validate", tmp_path / "set.h5", record, "--noise", bound, *options]
        code = main_guard(lambda: run_command(["data", *map(str, arguments)]))
        done = capsys.readouterr()
        return code, done.out, done.err

    return run


def record(model=LAG, **more):
    y = rl.simulate(model, T, {"u": U})["y"]
    return rl.Record(T, {"u": U}, {"y": y, **more})


def axis():
    return rl.plant("mass-spring-damper", m=2.0, c=(1.5, 0.25), k=8.0).uncertain()


def test_inconsistent_sampling(call, tmp_path):
    t = T.copy()
    t[30:] += 0.02
    for name, clock in (("jump", t), ("jitter", T + 0.01 * np.random.default_rng(0).uniform(-1, 1, len(T)))):
        code, out, err = call(rl.unstructured(LAG, 0.3), rl.Record(clock, {"u": U}, {"y": U}, name=name))
        assert (code, out) == (4, "")
        assert "irregular sampling" in err
        assert "uniform clock" in err
    rows = "".join(f"{a:.6f},{b},{b}\n" for a, b in zip(t, U, strict=True))
    (tmp_path / "gap.csv").write_text("t,u,y\n" + rows, encoding="utf-8")
    code, out, _ = call(rl.unstructured(LAG, 0.3), tmp_path / "gap.csv")
    assert code in (3, 4)  # a reader that sees the gap first calls it bad input
    assert out == ""


@pytest.mark.parametrize("domain", ["time", "frequency"])
def test_a_record_that_is_not_of_this_plant(call, domain):
    """The input is silent where the output moves, or one harmonic is driven and another one answers."""
    n = 30 if domain == "frequency" else len(T)
    u = np.sin(2 * np.pi * np.arange(60) / n) if domain == "frequency" else np.where(T < 1.5, 0.0, 1.0)
    other = np.cos(2 * np.pi * np.arange(60) * 4 / n)
    options = ("--domain", "frequency") if domain == "frequency" else ("--at-rest",)
    alien = rl.Record(T, {"u": u}, {"y": other})
    code, out, _ = call(rl.unstructured(LAG, 0.3), alien, *options, "--json")
    result = json.loads(out)
    assert (code, result["status"]) == (4, "infeasible")
    assert result["verdict"] == "invalidated at every gamma"
    assert (result["lower"], result["upper"]) == ("inf", "inf")
    assert result["excess"] > 10


def test_a_singular_noise_model(call):
    for options in ((), ("--domain", "frequency")):
        code, out, err = call(rl.unstructured(LAG, 0.3), record(), *options, bound="y=0")
        assert (code, out) == (4, "")
        assert "singular noise model" in err
    assert call(rl.unstructured(LAG, 0.3), record(), bound="y=-1")[0] == 3
    assert call(rl.unstructured(LAG, 0.3), record(), bound="y=nan")[0] == 3


class Panic(BaseException):
    """Raised by a native solver: not an Exception."""


def broken(kind):
    def solver(P, q, A, b, cones, settings):
        if kind == "panic":
            raise Panic
        nothing = np.full(len(q), np.nan), np.full(len(b), np.nan)
        answer = SimpleNamespace(status="NumericalError", x=nothing[0], z=nothing[1], iterations=1)
        return SimpleNamespace(solve=lambda: answer)

    return solver


@pytest.mark.parametrize("kind", ["panic", "no number"])
@pytest.mark.parametrize("options", [(), ("--domain", "frequency")])
def test_a_cone_solver_that_fails(call, monkeypatch, kind, options):
    import clarabel

    many = rl.simulate(LAG, np.arange(300) * 0.05, {"u": np.tile(U, 5)})["y"][-60:]
    wrong = rl.Record(T, {"u": U}, {"y": 1.4 * many})
    monkeypatch.setattr(clarabel, "DefaultSolver", broken(kind))
    code, out, err = call(rl.unstructured(LAG, 0.3), wrong, *options)
    assert (code, out) == (4, "")
    assert "the solver" in err
