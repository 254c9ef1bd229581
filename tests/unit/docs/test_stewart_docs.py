"""docs/stewart.md: the code in it runs; nothing is compiled or loaded before it is needed."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np

import robustlab as rl

ROOT = Path(__file__).parents[3]


def test_the_code_runs():
    text = (ROOT / "docs" / "stewart.md").read_text(encoding="utf-8")
    torque = rl.trim(rl.plant("stewart-platform", platform_mass=3.3), pose=[0.0, 0.0, 0.13, 0.02, 0.0, 0.0]).u
    home = rl.plant("stewart-platform").geometry.home
    names = {
        "t": np.linspace(0, 0.05, 11),
        "u": np.tile(torque, (11, 1)),
        "poses": np.tile(home, (2, 1)),
        "masses": [0.4, 0.5],
    }
    for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL):
        exec(block, names)
    assert names["found"].proved.all()
    np.testing.assert_allclose(names["found"].pose, names["pose"], atol=1e-12)
    assert names["many"].A.shape == (2, 12, 12)
    assert abs(names["record"]["phi_1"] - names["trim"].x[0]).max() < 1e-6


def test_the_compiler_is_loaded_on_first_use_only():
    code = "import robustlab as rl, sys; rl.plant('stewart-platform'); assert 'numba' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)
