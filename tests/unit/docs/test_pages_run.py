"""Code and commands of the pages run, and their numbers are right; names and links of the site lead somewhere."""

import re
import shlex
import shutil
import sys
import types
from importlib import import_module
from pathlib import Path

import control
import numpy as np
import pytest

import robustlab as rl
from robustlab.cli import main_guard
from robustlab.cli import run_command as run
from robustlab.dynamics import plant_names
from robustlab.recipe import json_schema

ROOT = Path(__file__).parents[3]
DOCS = ROOT / "docs"
# Tutorials whose header names a kernel are executed where the site is built.
TUTORIALS = sorted(
    page.stem for page in (DOCS / "tutorials").glob("*.md") if not page.read_text(encoding="utf-8").startswith("---")
)
QUICK = ["conventions", "models", "objects", "proofs"]
LONG = ["cover", "delays", "discover", "fixed_structure", "gain-scheduling", "iqc", "synthesis", "watch"]


def blocks_of(page: str) -> list[tuple[str, str]]:
    found = re.findall(r"```(python|sh)\n(.*?)```", (DOCS / f"{page}.md").read_text(encoding="utf-8"), flags=re.DOTALL)
    assert found
    return found


@pytest.mark.parametrize("page", [*QUICK, *(pytest.param(page, marks=pytest.mark.slow) for page in LONG)])
def test_the_code_of_a_page_runs(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for kind, block in blocks_of(page):
        if kind == "python":
            exec(block, names)


def test_the_code_of_the_platform_runs():
    torque = rl.trim(rl.plant("stewart-platform", platform_mass=3.3), pose=[0.0, 0.0, 0.13, 0.02, 0.0, 0.0]).u
    home = rl.plant("stewart-platform").geometry.home
    names = {
        "t": np.linspace(0, 0.05, 11),
        "u": np.tile(torque, (11, 1)),
        "poses": np.tile(home, (2, 1)),
        "masses": [0.4, 0.5],
    }
    for kind, block in blocks_of("stewart"):
        if kind == "python":
            exec(block, names)
    assert names["found"].proved.all()
    np.testing.assert_allclose(names["found"].pose, names["pose"], atol=1e-12)
    assert abs(names["record"]["phi_1"] - names["trim"].x[0]).max() < 1e-6


@pytest.mark.parametrize(
    "page",
    [
        *(f"tutorials/{page}" for page in TUTORIALS),
        pytest.param("your-own-machine", marks=pytest.mark.slow),  # it searches for the name of an effect
    ],
)
def test_the_code_and_the_commands_of_a_page_run(page, tmp_path, monkeypatch, capsys):
    shutil.copytree(ROOT / "models" / "plants", tmp_path / "models" / "plants")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    for kind, block in blocks_of(page):
        first = block.partition("\n")[0]
        if kind == "sh":
            for command in block.splitlines():
                program, *words = shlex.split(command)
                assert program == "robustlab"
                code = main_guard(lambda words=words: run(words))
                assert code == 0, (command, capsys.readouterr().err)
        elif first == "# stage.py":
            Path("stage.py").write_text(block)
        elif first != "# mymachine.py":  # the beginning of what a command has written
            exec(block, names)


# --- docs/analysis.md -------------------------------------------------------------------------------------------------


def python_of(name: str) -> list[str]:
    return re.findall(r"```python\n(.*?)```", (ROOT / name).read_text(encoding="utf-8"), flags=re.DOTALL)


@pytest.mark.slow
def test_the_page_runs_and_its_numbers_are_right(capsys):
    names = {}
    for block in python_of("docs/analysis.md"):
        exec(block, names)
    margin, gain, performance = names["margin"], names["gain"], names["performance"]
    # Routh: (1 - 0.2 t)(2 - 0.6 t) = 0.2 (3 + 0.6 t) where the softest, least damped, heaviest corner is just stable.
    exact = (1.12 - np.sqrt(1.12**2 - 4 * 0.12 * 1.4)) / 0.24
    assert margin.upper == pytest.approx(exact, rel=1e-6)
    assert exact * 0.99 < margin.lower < exact * (1 + 1e-9)
    assert sum(margin.shares.values()) == pytest.approx(1.0)
    assert max(margin.shares, key=margin.shares.get) == "k"
    # d ln t / d ln r by the same equation, r the range of k below its nominal value.
    slope = (1 - 0.2 * exact) * 0.6 + 0.2 * (2 - 0.6 * exact) + 0.12
    assert margin.shares["k"] == pytest.approx((1 - 0.2 * exact) * 0.6 / slope, rel=1e-4)
    assert names["four"].upper == pytest.approx(4.0, rel=1e-9)
    assert names["four"].lower == pytest.approx(4.0, rel=3e-3)
    assert names["seen"].growth == pytest.approx(1.0, abs=1e-3)
    # The gain of x / F at the softest, least damped, heaviest corner, on a grid of its own.
    s = 1j * np.linspace(0.5, 0.7, 20001)
    corner = np.abs(s / (s * (3.6 * s**2 + 0.8 * s + 1.4) + 0.2)).max()
    assert gain.lower == pytest.approx(corner, rel=1e-6)
    assert gain.lower <= gain.upper <= gain.lower * 1.01
    assert performance.lower <= performance.upper < 1 < gain.upper / 4
    assert names["bounds"].lower == pytest.approx(2.0)
    assert all(part.status is not rl.Status.TIMEOUT for part in (margin, gain, performance, names["disk"]))
    # 1 / |S - 1/2| for one loop, on a grid.
    s = 1j * np.linspace(0.5, 1.0, 20001)
    L = 0.2 / (s * (3 * s**2 + s + 2))
    assert names["disk"].lower == pytest.approx(1 / np.abs(1 / (1 + L) - 0.5).max(), rel=1e-6)
    # Chordal distance of two scalar models, on a grid: the nu-gap where the winding number is 0.
    s = 1j * np.linspace(0.5, 1.0, 20001)
    one, two = 1 / (3 * s**2 + s + 2), 1 / (3 * s**2 + s + 1.4)
    chordal = np.abs(one - two) / np.sqrt((1 + np.abs(one) ** 2) * (1 + np.abs(two) ** 2))
    assert f"{chordal.max():.5f}" == "0.36913"  # as printed
    # |1 + g K| / (0.05 |g K|), and the largest |g' / (1 + g' K)| over the disks, at the points of the page.
    s = 1j * np.geomspace(0.05, 20.0, 40)
    g, k = 1 / (3 * s**2 + s + 2), 0.2 / s
    assert names["points"].lower == pytest.approx((np.abs(1 + g * k) / (0.05 * np.abs(g * k))).min(), rel=1e-6)
    disks = g[:, None] * (1 + 0.05 * np.exp(2j * np.pi * np.arange(4000) / 4000))
    assert np.abs(disks / (1 + disks * k[:, None])).max() == pytest.approx(1.943, abs=1e-3)
    printed = capsys.readouterr().out
    for number in ("1.4868", "5.8554", "5.8560", "0.36913", "22.12", "1.943", "[1.628 1.64 ]"):
        assert number in printed


# --- docs/plants.md ---------------------------------------------------------------------------------------------------


TEXT = (Path(__file__).parents[3] / "docs" / "plants.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```python\n(.*?)```", TEXT, flags=re.DOTALL)


def test_the_code_runs_and_the_tank_is_right(monkeypatch):
    module = types.ModuleType("water_tank")
    monkeypatch.setitem(sys.modules, "water_tank", module)
    names = {"rl": rl, "t": np.arange(10) * 0.1, "volts": np.ones(10)}
    for block in (b for b in BLOCKS if "motor.fmu" not in b):  # tests/dynamics/test_fmu.py has a unit
        exec(block, module.__dict__ if block.startswith("# water_tank.py") else names)
    tanks = names["tanks"]
    assert tanks.parameters["A1"].value == 0.6
    # by hand: A1 h1' = inflow - g1 h1, A2 h2' = g1 h1 - g2 h2
    model = rl.linearise(tanks)
    np.testing.assert_allclose(model.A, [[-0.02 / 0.6, 0], [0.02 / 0.8, -0.03 / 0.8]])
    np.testing.assert_allclose(model.dc_gain(), [[50.0], [100 / 3]])
    uncertain = tanks.uncertain()
    assert [(b.name, b.repeats) for b in uncertain.blocks] == [("g1", 1), ("g2", 1)]
    np.testing.assert_allclose(uncertain.evaluate({"g1": 1.0}).A, tanks.with_parameters(g1=0.023).state_space().A)
    assert names["pair"].physical({"J": 1.0})["J"] == (pytest.approx(7.92e-6), "kg m2")


def test_the_table_names_every_plant_and_its_signals():
    for name in plant_names():
        row = next(line for line in TEXT.splitlines() if line.startswith(f"| `{name}`"))
        plant = rl.plant(name)
        for word in (*plant.parameters, *(s.name for s in (*plant.inputs, *plant.outputs))):
            assert re.search(rf"[` ]{word}[` :]", row), (name, word)


# --- docs/conventions.md ----------------------------------------------------------------------------------------------


G = rl.StateSpaceModel(
    [[0.0, 1.0], [-1.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]], inputs=["u"], outputs=[("q", "rad")]
)


def test_the_gain_of_python_control_s_lqr_closes_the_loop_of_the_states():
    K, _, _ = control.lqr(G.to_control(), np.eye(2), [[1.0]])
    states = rl.StateSpaceModel(G.A, G.B, np.eye(2), np.zeros((2, 1)))
    margin = rl.disk_margin(states, K, sign=-1, at="input").simultaneous
    assert margin.lower >= 1.0 - 1e-9  # Kalman's inequality: |1 + L| >= 1, a disk of gains from 1/2 up with skew 1
    positive = -K
    with pytest.raises(rl.NoTrustworthyNumber, match="unstable"):
        rl.disk_margin(states, 3 * positive, at="input")


def test_the_break_point_is_named():
    two = rl.StateSpaceModel(-np.eye(2), np.eye(2), [[1, 2], [0, 1]], np.zeros((2, 2)), outputs=["p", "q"])
    gain = rl.StateSpaceModel([], [], [], [[1, 0], [0, 4]])
    at_output, at_input = (rl.disk_margin(two, gain, at=at) for at in ("output", "input"))
    assert (at_output.at, list(at_output.channels)) == ("output", ["p", "q"])
    assert (at_input.at, list(at_input.channels)) == ("input", ["u1", "u2"])
    # The two orders of the product are the two places.
    assert rl.disk_margin(two @ gain).simultaneous.lower == pytest.approx(at_output.simultaneous.lower, rel=1e-3)
    assert rl.disk_margin(gain @ two).simultaneous.lower == pytest.approx(at_input.simultaneous.lower, rel=1e-3)


def test_phases_are_radians_here_and_degrees_in_python_control():
    import control

    L = 4.0 * rl.StateSpaceModel([[0, 1], [0, -1]], [[0], [1]], [[1, 0]], [[0]])
    _, degrees, _, _ = control.margin(L.to_control())
    found = rl.classical_margins(L).channels["y1"]
    assert found.phase_margin == pytest.approx(np.radians(degrees), rel=1e-6)
    assert "degrees" in found.summary()


# --- the site: every public name, every key of a recipe has its place; links hold -------------------------------------


reference_pages = import_module("reference_pages")

PAGES = reference_pages.pages()


def test_every_public_name_has_a_page_and_stands_in_the_contents():
    assert [name for names in reference_pages.groups().values() for name in names] == rl.__all__
    for name in rl.__all__:
        assert re.search(rf"^\.\. auto\w+:: {name}$", PAGES[f"api/{name}.rst"], re.M), name
        assert f":py:obj:`{name} <robustlab.{name}>`" in PAGES["api/index.rst"]


def test_every_step_and_every_key_of_a_recipe_is_on_the_page():
    schema = json_schema()
    page = PAGES["recipe.rst"]
    steps = [part for part in schema["$defs"].values() if "do" in part["properties"]]
    assert len(steps) > 30
    for part in steps:
        name = part["properties"]["do"]["const"]
        section = page.split(f".. _step-{name}:\n")[1].partition("\n.. _step-")[0]
        assert [key for key in part["properties"] if key != "do" and f"\n``{key}`` : " not in section] == []


def every_page() -> list[Path]:
    return [page for page in sorted(DOCS.rglob("*.md")) if "reference" not in page.relative_to(DOCS).parts]


@pytest.mark.parametrize("page", every_page(), ids=lambda page: page.relative_to(DOCS).as_posix())
def test_a_page_leads_somewhere_and_names_what_there_is(page):
    """A fast form of the checks of the site's build."""
    text = re.sub(r"```.*?```", "", page.read_text(encoding="utf-8"), flags=re.S)
    for target in re.findall(r"\]\(([^)#\s]+)[^)]*\)", text):
        if "://" in target:
            continue
        _, below, name = target.partition("reference/")
        assert (name in PAGES) if below else (page.parent / target).exists(), target
    assert [name for name in re.findall(r"`rl\.([A-Za-z]\w*)", text) if name not in rl.__all__] == []


def test_every_page_is_in_the_contents():
    """Every page is in a table of contents; the build checks this, too."""
    from fnmatch import fnmatch

    held = []
    for page in every_page():
        for block in re.findall(r"```\{toctree\}\n(.*?)```", page.read_text(encoding="utf-8"), re.S):
            held += [
                (page.parent / line).relative_to(DOCS).as_posix()
                for line in block.splitlines()
                if line and not line.startswith(":")
            ]
    names = [page.relative_to(DOCS).with_suffix("").as_posix() for page in every_page()]
    lost = [n for n in names if n != "index" and not any(fnmatch(n, h) and n.count("/") == h.count("/") for h in held)]
    assert lost == []
