"""The table of codecs: every row exists, and a process loads only the modules of the objects it reads and writes."""

import subprocess
import sys

import numpy as np
import pytest

import robustlab as rl
from robustlab.files import KINDS
from robustlab.synthesis import LPVController

G = rl.ss([[-1.0, 0.0], [0.0, -2.0]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
H = rl.ss([[-1.5, 0.0], [0.0, -2.0]], [[1.0], [1.0]], [[1.0, 1.0]], [[0.0]])
# Modules of robustlab, at most, that one `rl.load` needs; a plant brings its equations, delays their algebra.
MOST = 40
MORE = {"delayed": 46, "plant": 85}
# Packages above the models, and what of them a kind of file needs.
ABOVE = {"delays", "dynamics", "worst_case_analysis", "mu_analysis", "iqc", "synthesis", "identification"}
ABOVE |= {"campaign", "report", "thesis", "recipe", "cli", "norms"}
NEEDED = {
    "delayed": {"delays"},
    "lpv": {"synthesis"},
    "lpv-controller": {"synthesis"},
    "controller": {"synthesis"},
    "plant": {"delays", "dynamics"},
}
# No file needs these.
OF_DESIGN = (
    "problem.design",
    "problem.generalized_plant",
    "scheduling.scheduled_synthesis",
    "hinf",
)  # no file needs these
HEAVY = {"scipy", "h5py", "matplotlib", "control", "cvxpy", "pandas", "pydantic"}

LOAD = """
import sys
import robustlab as rl

rl.load(sys.argv[1])
print(*sys.modules)
"""


def things():
    uncertain, scheduled = rl.elementwise(G, H), rl.LPVModel({"p": [0.0, 1.0]}, [G, H])
    t = np.linspace(0.0, 1.0, 11)
    return {
        "state-space": G,
        "uncertain": uncertain,
        "delayed": rl.with_delays(G, {0: 0.1}),
        "frequency-data": rl.frequency_data(uncertain, [1.0, 2.0, 3.0]),
        "lpv": scheduled,
        "lpv-controller": LPVController(scheduled),
        "controller": rl.Controller(G, takes="r - y"),
        "record": rl.Record(t, {"u": np.sin(t)}, {"y": np.cos(t)}),
        "plant": rl.plant("servo-axis"),
        "result": rl.h2_norm(G),
    }


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored")
    return {kind: rl.save(folder / f"{kind}.h5", thing) for kind, thing in things().items()}


def loaded_by(path):
    """Modules after loading a file."""
    command = [sys.executable, "-c", LOAD, str(path)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return done.stdout.split()


def check(kind, path):
    loaded = loaded_by(path)
    ours = [name.removeprefix("robustlab.") for name in loaded if name.split(".")[0] == "robustlab"]
    assert len(ours) <= MORE.get(kind, MOST), ours
    assert {name.split(".")[0] for name in ours} & ABOVE <= NEEDED.get(kind, set())
    assert not [name for name in ours if name.removeprefix("synthesis.").startswith(OF_DESIGN)]
    assert not {name.split(".")[0] for name in loaded} & HEAVY


@pytest.mark.parametrize("kind", KINDS)
def test_a_process_loads_only_the_modules_it_needs(kind, files):
    check(kind, files[kind])
