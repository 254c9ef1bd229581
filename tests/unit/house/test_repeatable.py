"""Results do not depend on the machine's load: budgets count work, and a time limit that is reached is reported."""

import re

import numpy as np
import pytest
from repeatable import same_under_load

import robustlab as rl
from robustlab.budget import NOT_REPEATABLE, USED_UP

# Six real parameters, D-G bounds 3 % apart; an output that they move.
MODEL = """
def model(size):
    rng, n = np.random.default_rng(10), 6
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n)
    B = np.hstack([size * rng.standard_normal((n, n)), np.ones((n, 1))])
    C = np.vstack([rng.standard_normal((n, n)), np.ones((1, n))])
    M = rl.StateSpaceModel(A, B, C, np.zeros((n + 1, n + 1)))
    return rl.UncertainModel(M, [rl.RealScalar(f"p{i}") for i in range(n)])
"""
STEP = """
M = rl.StateSpaceModel([[-1.0]], [[0.4, 0.2, 1.0]], [[1.0], [0.0], [1.0]], [[0, 0, 0], [0, 0, 1.0], [0, 0, 0]])
model = rl.UncertainModel(M, [rl.RealScalar("pole"), rl.RealScalar("gain")])
t = 0.1 * np.arange(60)
u = np.sign(np.sin(1.3 * t))
truth = rl.simulate(model.evaluate({"pole": 0.7, "gain": -0.4}), t, {"u3": u})["y3"]
record = rl.Record(t, {"u3": u}, {"y3": truth + 0.01 * np.sin(37 * np.arange(60))})
"""


def of(source: str) -> dict:
    names: dict = {"np": np, "rl": rl}
    exec(source, names)
    return names


# --- the same under load ----------------------------------------------------------------------------------------------


RECIPE = """
schema = "robustlab.recipe/1"
name = "loop"
[step.motor]
do = "plant"
plant = "dc-motor"
[step.set]
do = "uncertain"
of = "motor"
tolerances = { Kf = 0.35, R = 0.1, J = 0.1 }
outputs = ["omega"]
[step.margin]
do = "robust-stability"
of = "set"
effort = 0.0005
[step.worst]
do = "worst-case"
of = "set"
metric = "hinf"
effort = 0.0002
"""
# Snippets, each with a pattern of its output.
SNIPPETS = {
    "mu to a tolerance": ("""
rng = np.random.default_rng(3)
M = rng.standard_normal((2, 8, 8)) + 1j * rng.standard_normal((2, 8, 8))
bounds = rl.mu(M, [[-1, 0]] * 8, tolerance=1e-4, effort=0.001)
print(*bounds.notes, digest(bounds))
""", re.escape(USED_UP)),
    "margin and gain where the budget ends the proof": (MODEL + """
margin = rl.robust_stability(model(0.3), effort=1e-3, tolerance=1e-4)
gain = rl.peak_gain(model(0.2), effort=5e-4, tolerance=1e-4)
print(*margin.notes, digest(margin), *gain.notes, digest(gain))
""", rf"{re.escape(USED_UP)}.*{re.escape(USED_UP)}"),
    "worst member": (MODEL + """
found = rl.worst_case(model(0.2), "h2", n=64, effort=1e-3)
print(found.status, found.label, digest(found))
""", rf"^inconclusive .*{re.escape(USED_UP)}"),
    "discovery": ("""
from robustlab.dynamics import catalogue
t, rng = 2.5e-3 * np.arange(500), np.random.default_rng(0)
u = np.repeat(rng.uniform(-3.0, 3.0, size=10), 50)
machine = rl.with_effects(rl.plant("servo-axis"), {"coulomb-friction": {"Fc": 20.0}})
q = rl.simulate(machine, t, u)["q"] + 1e-6 * rng.standard_normal(500)
others = sorted(set(catalogue()) - {"coulomb-friction", "constant-load"})
found = rl.discover(rl.plant("servo-axis"), rl.Record(t, {"u": u}, {"q": q}, {"u": "V", "q": "m"}), exclude=others)
print(found.verdict, digest(found))
""", "^named "),
    "recipe": (f"""
import contextlib, io, json, os, tempfile
from robustlab.cli import main_guard
from robustlab.cli import run_command as run
with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
    os.chdir(folder)
    open("loop.toml", "w").write({RECIPE!r})
    code = main_guard(lambda: run(["run", "loop.toml", "--out", "out"]))
    steps = json.load(open("out/result.json"))["steps"]
    os.chdir("/")
print(code, [(s["name"], s["status"]) for s in steps], digest(steps))
""", "inconclusive"),
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("what", SNIPPETS)
def test_the_answer_is_the_same_under_load(what):
    snippet, pattern = SNIPPETS[what]
    assert re.search(pattern, same_under_load(snippet), re.DOTALL)


# --- time limit and effort --------------------------------------------------------------------------------------------


def test_a_time_limit_that_is_reached_is_reported():
    matrix = of("rng = np.random.default_rng(3)\nM = rng.standard_normal((8, 8)) + 1j * rng.standard_normal((8, 8))")[
        "M"
    ]
    uncertain, names = of(MODEL)["model"](0.2), of(STEP)
    for found in (
        rl.mu(matrix, [[-1, 0]] * 8, tolerance=1e-4, time_limit=0.0),
        rl.robust_stability(uncertain, time_limit=0.0),
        rl.peak_gain(uncertain, time_limit=0.0),
        rl.validate(names["model"], names["record"], {"y3": 0.012}, at_rest=True, time_limit=0.0),
    ):
        assert found.status is rl.Status.TIMEOUT
        assert NOT_REPEATABLE in found.notes
    found = rl.worst_case(uncertain, "h2", time_limit=0.0)
    assert found.status is rl.Status.TIMEOUT
    assert NOT_REPEATABLE in found.label


def test_more_effort_proves_more_and_reports_the_rest():
    uncertain = of(MODEL)["model"](0.3)
    margins = [rl.robust_stability(uncertain, effort=e, tolerance=1e-4) for e in (5e-5, 1e-3, 1.0)]
    assert [m.status.value for m in margins] == ["inconclusive", "certified", "certified"]
    assert margins[0].lower == 0 < margins[1].lower < margins[2].lower
    assert [USED_UP in m.notes for m in margins] == [True, True, False]
    # Other efforts may find the same destabilising parameters by another way, and so with other last bits.
    assert [m.upper for m in margins] == pytest.approx([margins[0].upper] * 3, rel=1e-12)
