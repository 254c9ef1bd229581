"""The public interface: the names of DESIGN, each importable, no numerical library loaded at import."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest
from patience import PATIENCE
from stub import STUB, stub_text

import robustlab as rl


def test_importing_the_package_loads_nothing_heavy():
    code = "import sys, robustlab; print(' '.join(sorted({m.split('.')[0] for m in sys.modules})))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"numpy", "scipy", "control", "cvxpy", "h5py", "matplotlib", "pydantic"} & set(loaded)


def test_the_stub_equals_the_table():
    assert STUB.read_text(encoding="utf-8") == stub_text(), "run: python benchmarks/stub.py"


@pytest.mark.slow
def test_a_type_checker_knows_every_public_name(tmp_path):
    lines = ["import robustlab as rl", *(f"reveal_type(rl.{name})" for name in (*rl.__all__, "__version__"))]
    (tmp_path / "user.py").write_text("\n".join(lines))
    command = [sys.executable, "-m", "pyright", "--outputjson", "--pythonpath", sys.executable, "user.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=PATIENCE)
    found = {d["range"]["start"]["line"]: d for d in json.loads(done.stdout)["generalDiagnostics"]}
    for k, line in enumerate(lines[1:], start=1):
        message = found[k]["message"]
        assert found[k]["severity"] == "information", message
        assert message.rpartition(" is ")[2].strip('"') not in ("Any", "Unknown"), line
