"""docs/effects.md: its code runs, the effect built in it is right, its table is that of the catalogue."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import robustlab as rl
from robustlab.dynamics import Scales, catalogue

TEXT = (Path(__file__).parents[3] / "docs" / "effects.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)


@pytest.fixture
def names(monkeypatch, tmp_path):
    """Return the variables after running the code of the page."""
    monkeypatch.setattr("robustlab.dynamics.effects.catalogue._ADDED", {})
    monkeypatch.syspath_prepend(tmp_path)
    found = {}
    for block in BLOCKS:
        if block.startswith("# eddy_current_brake.py"):
            (tmp_path / "eddy_current_brake.py").write_text(block, encoding="utf-8")
        else:
            exec(block, found)
    yield found
    sys.modules.pop("eddy_current_brake", None)


def test_the_code_runs_and_the_brake_brakes(names):
    t, volts, motor = names["t"], names["volts"], names["motor"]
    p = motor.values

    def rate(time, x):
        omega, i = x
        brake = 2 * 0.08 * (omega / 40.0) / (1 + (omega / 40.0) ** 2)
        u = volts[min(int(time / 1e-3 + 1e-9), len(volts) - 1)]
        return [(p["Km"] * i - p["Kf"] * omega - brake) / p["J"], (u - p["R"] * i - p["Kb"] * omega) / p["L"]]

    truth = solve_ivp(rate, (0, t[-1]), [0, 0], t_eval=t, rtol=1e-8, atol=1e-10, max_step=2.5e-4).y[0]
    braked = rl.simulate(names["braked"], t, {"u": volts})["omega"]
    free = rl.simulate(motor, t, {"u": volts})["omega"]
    assert np.abs(free - truth).max() > 20.0
    assert np.abs(braked - truth).max() < 0.03 * np.abs(free - truth).max()
    # at rest in the speed both agree: no trace of the step
    assert braked[240] == pytest.approx(truth[240], rel=1e-4)


@pytest.mark.parametrize("name", catalogue())
def test_the_table_is_that_of_the_catalogue(name):
    known = catalogue()[name]
    row = next(line for line in TEXT.splitlines() if line.startswith(f"| `{name}`"))
    first, equation, parameters, site = (c.strip() for c in re.split(r"(?<!\\)\|", row)[1:-1])
    assert first == f"`{name}`" + (f" ({known.refines})" if known.refines else "")
    assert equation == f"`{known.equation}`".replace("|", r"\|")
    symbols = {p.name for s in (Scales(), Scales(force_unit="N")) for p in known.parameters(s)}
    assert set(re.findall(r"`(\w+)`", parameters)) == symbols
    assert site.startswith(known.site_kind)
