"""The public interface: the names of DESIGN, each importable, nothing heavy at import."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from patience import PATIENCE
from stub import STUB, stub_text

import robustlab as rl

# What users and outside checks call, as far as this version has it.
CONTRACT = [
    "StateSpaceModel",
    "load",
    "save",
    "RealScalar",
    "ComplexScalar",
    "FullBlock",
    "UncertainModel",
    "elementwise",
    "sample",
    "worst_case",
    "mu",
    "robust_stability",
    "hinf",
    "mixsyn",
    "plant",
    "linearise",
    "simulate",
    "Record",
    "compare",
    "discover",
]


@pytest.mark.parametrize("name", rl.__all__)
def test_every_public_name_can_be_loaded(name):
    assert getattr(rl, name) is not None


def test_the_contract_is_public():
    assert set(CONTRACT) <= set(rl.__all__)


def test_dir_shows_the_public_names():
    assert set(rl.__all__) <= set(dir(rl))


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match=r"robustlab has no 'mussv'; MATLAB's mussv is rl\.mu$"):
        rl.mussv  # noqa: B018


@pytest.mark.parametrize("name", rl.__all__)
def test_every_public_object_says_what_it_is(name):
    assert (getattr(rl, name).__doc__ or "").strip()


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, robustlab; print(' '.join(sorted({m.split('.')[0] for m in sys.modules})))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "scipy", "control", "cvxpy", "h5py", "matplotlib", "pydantic"} & set(loaded)


def test_the_stub_says_what_the_table_says():
    assert STUB.read_text(encoding="utf-8") == stub_text(), "run: python benchmarks/stub.py"


def test_a_type_checker_knows_every_public_name(tmp_path):
    lines = ["import robustlab as rl", *(f"reveal_type(rl.{name})" for name in (*rl.__all__, "__version__"))]
    (tmp_path / "user.py").write_text("\n".join(lines))
    command = [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, "user.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=PATIENCE)
    found = {d["range"]["start"]["line"]: d for d in json.loads(done.stdout)["generalDiagnostics"]}
    for k, line in enumerate(lines[1:], start=1):
        said = found[k]["message"]
        assert found[k]["severity"] == "information", said
        assert said.rpartition(" is ")[2].strip('"') not in ("Any", "Unknown"), line
