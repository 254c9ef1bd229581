"""``robustlab recipe check`` reports all faults that can be found before the first step, and nothing else."""

import re
from pathlib import Path

import numpy as np
import pytest
from shell import robustlab

import robustlab as rl
from robustlab.recipe import KINDS

ROOT = Path(__file__).parents[2]
HEAD = 'schema = "robustlab.recipe/1"\nname = "r"\n'
MOTOR = '[step.motor]\ndo = "plant"\nplant = "dc-motor"\n'
SPEED = '[step.speed]\ndo = "linearise"\nof = "motor"\noutputs = ["omega"]\n'
SET = '[step.set]\ndo = "uncertain"\nof = "motor"\ntolerances = { Kf = 0.35 }\noutputs = ["omega"]\n'
DESIGN = '[step.k]\ndo = "mixsyn"\nof = "speed"\nW1 = { bandwidth = 150.0 }\n'
LOOP = '[step.loop]\ndo = "close-loop"\nof = "set"\ncontroller = "k"\n'
MARGIN = '[step.margin]\ndo = "robust-stability"\nof = "loop"\n'
WHOLE = HEAD + MOTOR + SPEED + SET + DESIGN + LOOP + MARGIN
FILE = '[step.m]\ndo = "load"\npath = "m.h5"\n'
RECORD = '[step.record]\ndo = "record"\npath = "r.csv"\ninputs = ["u"]\noutputs = ["phi", "i"]\n'
GAP = '[step.gap]\ndo = "compare"\nof = "motor"\nrecord = "record"\n'
NAMING = '[step.naming]\ndo = "discover"\nof = "motor"\nrecords = ["record"]\nexclude = ["cogging"]\n'


def require(that, condition, unit=""):
    label = f'unit = "{unit}"\n' if unit else ""
    return f'[[require]]\ntext = "t"\nthat = "{that}"\n{condition}\n{label}'


def driven(kind, keys, of="set"):
    return f'[step.driven]\ndo = "{kind}"\nof = "{of}"\nt_end = 0.1\n{keys}\n'


@pytest.fixture
def checked(tmp_path, monkeypatch):
    """Exit code and lines on stderr of ``recipe check`` on a text; no step may run."""
    monkeypatch.chdir(tmp_path)
    t = np.arange(0, 0.1, 1e-3)
    rows = "\n".join(f"{a:.3f},{b},0.0,0.0" for a, b in zip(t, np.sin(t), strict=True))
    (tmp_path / "r.csv").write_text(f"t [s],u [V],phi [rad],i [A]\n{rows}\n")
    rl.save(tmp_path / "m.h5", rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=["u1"], outputs=["y1"]))

    def stops(self, work):
        raise AssertionError("a step ran")

    for kind in KINDS.values():
        monkeypatch.setattr(kind, "run", stops)

    def call(text):
        (tmp_path / "r.toml").write_text(text)
        code, _, err = robustlab("recipe", "check", "r.toml")
        return code, err.splitlines()

    return call


@pytest.mark.parametrize(
    ("text", "fault"),
    [
        (
            HEAD + MOTOR + SPEED.replace("omega", "omga"),
            "step.speed.outputs.0: 'omga': motor has no such output, expected one of phi, omega, i",
        ),
        (WHOLE + require("margin.lowre", "at_least = 1.0"), "require.0.that: margin has no 'lowre', expected one of"),
        (WHOLE + require("margin.frequency", "at_least = 1.0", "Hz"), "require.0.unit: Hz, expected rad/s, that of"),
        (WHOLE + require("margin.lower", "at_least = 1.0", "%"), "require.0.unit: %, expected no unit: it is a pure"),
        (HEAD + MOTOR + 'parameters = { L = "0.3 mW" }\n', "step.motor: dc-motor: L: '0.3 mW'"),
        (HEAD + MOTOR + 'parameters = { Rr = 2.0 }\n', "step.motor: dc-motor: 'Rr': no such parameter"),
        (WHOLE.replace("Kf =", "Kff ="), "step.set.tolerances.Kff: 'Kff': motor has no such parameter, expected"),
        (WHOLE + driven("sample", "input = { v = 1.0 }"), "step.driven.input.v: 'v': set has no such input, expected"),
        (
            WHOLE + driven("sample", "input = { u = 1.0 }", "loop"),
            "step.driven.input.u: 'u': loop has no such input, expected one of omega_ref",
        ),
        (
            WHOLE + driven("worst-case", 'input = { u = 1.0 }\noutput = "phi"'),
            "step.driven.output: 'phi': set has no such output, expected one of omega",
        ),
        (
            WHOLE + driven("sample", "input = { u = 1.0 }") + require("driven.outputs.phi.covers.0", "equals = true"),
            "driven.outputs has no 'phi', expected one of omega",
        ),
        (HEAD + '[step.m]\ndo = "load"\npath = "gone.h5"\n', "step.m.path: gone.h5: no such file"),
        (
            HEAD + FILE + '[step.s]\ndo = "steady-state"\nof = "m"\ninputs = { u = 1.0 }\n',
            "step.s.inputs.u: 'u': m has no such input, expected one of u1",
        ),
        (
            HEAD + FILE + '[step.s]\ndo = "robust-stability"\nof = "m"\n',
            "step.s.of: step 'm' gives a StateSpaceModel, expected an UncertainModel",
        ),
        (HEAD + RECORD.replace('"phi"', '"phii"'), "step.record: "),
        (HEAD + MOTOR + RECORD.replace("r.csv", "m.h5") + GAP, "holds an object of kind state-space"),
        (HEAD + MOTOR.replace("dc-motor", "servo-axis") + RECORD + GAP, "no output in common (record: phi, i"),
        (HEAD + MOTOR + RECORD + 'units = { phi = "mm" }\n' + GAP, "phi"),
        (HEAD + MOTOR + RECORD + GAP + require("gap.outputs.omega.fit", "at_least = 1.0"), "one of phi, i"),
        (
            HEAD + MOTOR + RECORD + GAP + require("gap.outputs.i.rms", "at_most = 1.0", "V"),
            "require.0.unit: V, expected A, that of gap.outputs.i.rms",
        ),
        (
            HEAD + MOTOR + RECORD + NAMING + require("naming.effects.coulomb-fricton.Fc", "at_most = 1.0"),
            "naming.effects has no 'coulomb-fricton'",
        ),
        (
            HEAD + MOTOR + RECORD + NAMING + require("naming.effects.cogging.amplitude", "at_most = 1.0"),
            "naming.effects has no 'cogging'",  # excluded by the step
        ),
        (HEAD + MOTOR + RECORD + NAMING.replace("cogging", "coging"), "step.naming: "),
    ],
)  # fmt: skip
def test_faults_are_reported_before_anything_runs(checked, text, fault):
    code, lines = checked(text)
    assert code == 3, lines
    assert fault in lines[0]
    assert lines[0].startswith("error: r.toml: ")


@pytest.mark.parametrize(
    "text",
    [
        WHOLE + require("margin.lower", "at_least = 1.0") + require("margin.frequency", "at_most = 9.0", "rad / s"),
        WHOLE + require("margin.delta.whatever", "at_most = 1.0"),  # which blocks there are shows in the run
        WHOLE + require("loop.status", 'equals = "done"') + require("set.blocks", 'contains = "Kf"'),
        WHOLE + driven("sample", "input = { omega_ref = 1.0 }", "loop")
        + require("driven.outputs.u.final.upper", "at_most = 9.0", "V"),
        HEAD + MOTOR + RECORD + GAP + require("gap.outputs.phi.windowed_fit", "at_least = 1.0", "%")
        + require("gap.residual.phi.whiteness.p_value", "at_most = 1.0") + require("gap.noise.reason", 'equals = "x"')
        + require("gap.disturbance.u.forward", "at_most = 1.0", "V") + require("gap.worst.output", 'equals = "i"'),
        HEAD + MOTOR + RECORD + NAMING + require("naming.effects.coulomb-friction@omega.Fc", "at_most = 1.0", "N m")
        + require("naming.names", 'contains = "backlash"') + require("naming.nominal.Kf", "at_most = 1.0", "N m s/rad")
        + require("naming.free_run.outputs.phi.updated", "at_most = 1.0", "rad"),
        HEAD + FILE + require("m.poles.0.re", "at_most = 0.0", "rad/s") + require("m.outputs", 'contains = "y1"'),
        WHOLE + require("set.blocks.7", 'equals = "x"') + require("speed.poles.9.re", "at_most = 0.0"),
    ],
)  # fmt: skip
def test_what_only_the_run_can_show_is_no_fault(checked, text):
    assert checked(text) == (0, [])


def test_all_faults_are_reported_at_once_each_with_its_key_and_a_hint(checked):
    text = WHOLE.replace('"omega"', '"omga"', 1).replace("Kf =", "Kff =") + driven("sample", "input = { v = 1.0 }")
    text += '[step.m]\ndo = "load"\npath = "gone.h5"\n[step.n]\ndo = "load"\npath = "gone.h5"\n'
    code, lines = checked(text + require("margin.lowre", "at_least = 1.0") + require("k.gama", "at_most = 1.0"))
    assert code == 3
    assert lines[0] == "error: r.toml: 7 faults"
    keys = [line.strip().partition(": ")[0] for line in lines[1:]]
    assert keys == [
        "step.speed.outputs.0", "step.set.tolerances.Kff", "step.driven.input.v", "step.m.path", "step.n.path",
        "require.0.that", "require.1.that",
    ]  # fmt: skip
    assert lines[1].endswith("expected one of phi, omega, i (did you mean omega?)")
    assert lines[-2].endswith("(did you mean lower?)")
    assert lines[-1].endswith("(did you mean gamma?)")


def test_a_plant_in_a_file_is_not_run(checked, tmp_path):
    (tmp_path / "mine.py").write_text("raise SystemExit('it ran')\n")
    plant = '[step.motor]\ndo = "plant"\nplant = "mine.py:motor"\n'
    assert checked(HEAD + plant + SPEED.replace("omega", "anything")) == (0, [])


@pytest.mark.parametrize("name", sorted(path.stem for path in (ROOT / "recipes").glob("*.toml")))
def test_shipped_recipes_require_numbers_that_their_steps_give(name):
    code, _, err = robustlab("recipe", "check", name)
    faults = [line for line in err.splitlines() if re.match(r"(error: \S+: |  )(step|require)\.", line)]
    # Without the records that are not ours to ship, their absence is all that is wrong.
    assert (code, bool(faults)) in ((0, False), (3, True))
    assert all("../shared/data/" in line for line in faults), err
