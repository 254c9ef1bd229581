"""Plants by the name ``file.py:name``: construction and provenance."""

import hashlib
import sys

import numpy as np
import pytest

import robustlab as rl
from robustlab.dynamics import builtin_plant
from robustlab.errors import DependencyMissing, InputError
from robustlab.files import read_tree, stamp, write_tree
from robustlab.provenance import Provenance

AXIS = """
from robustlab.dynamics import Descriptor, LinearPlant, Parameter, overridden
from robustlab.statespace import Signal

PARAMETERS = (
    Parameter("M", 95.0, "kg", 0.05, "weighed", "moving mass", "positive", role="inertia"),
    Parameter("Fv", 203.0, "N s/m", 0.1, "coasting", "viscous friction", "nonnegative", role="viscous-friction"),
)


def axis(**given):
    states = (Signal("q", "m"), Signal("v", "m/s"))
    parameters = overridden(PARAMETERS, given, "axis")
    return LinearPlant("axis", parameters, (Signal("F", "N"),), states, states, equations)


def equations(p):
    return Descriptor(E=[[1, 0], [0, p["M"]]], F=[[0, 1], [0, -p["Fv"]]], G=[[0], [1]], C=[[1, 0], [0, 1]])


ready = axis(M=50.0)


def fixed():
    return ready


def choice(heavy=False):
    return axis(M=500.0) if heavy else axis()
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "axis.py").write_text(AXIS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def mass(plant):
    """By the equation of motion: v' = F / M."""
    return 1.0 / rl.linearise(plant).B[1, 0]


@pytest.mark.parametrize(
    ("name", "given", "expected"),
    [
        ("axis", {}, 95.0),
        ("axis", {"M": 96.0}, 96.0),
        ("axis", {"M": (96.0, 0.2)}, 96.0),
        ("ready", {}, 50.0),
        ("ready", {"M": 51.0}, 51.0),  # a plant that is no function takes them by its with_parameters
        ("fixed", {"M": 52.0}, 52.0),
        ("choice", {"heavy": True}, 500.0),
        ("choice", {"heavy": True, "M": 501.0}, 501.0),  # other names go to the plant
    ],
)
def test_a_plant_or_a_function_with_parameters(folder, name, given, expected):
    assert mass(rl.plant(f"axis.py:{name}", **given)) == pytest.approx(expected, rel=1e-15)


def test_the_plant_knows_the_hash_of_its_file_and_a_saved_one_keeps_it(folder):
    plant = rl.plant("axis.py:axis", M=96.0)
    digest = hashlib.sha256((folder / "axis.py").read_bytes()).hexdigest()
    assert plant.provenance.inputs == {"axis.py": digest}
    assert plant.provenance.note == "axis.py:axis"
    assert plant.with_parameters(M=97.0).provenance == plant.provenance
    rl.save("axis.h5", plant)
    again = rl.load("axis.h5")
    assert again.provenance.inputs == {"axis.py": digest}
    np.testing.assert_array_equal(rl.linearise(again).B, rl.linearise(plant).B)


def test_modules_of_the_folder_are_imported_and_hashed_and_do_not_mix(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, value in (("one", 10.0), ("two", 20.0)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "axis.py").write_text(AXIS.replace("95.0", "numbers_of_mine.M") + "\nimport helping.more\n")
        text = (tmp_path / name / "axis.py").read_text()
        (tmp_path / name / "axis.py").write_text(f"import numbers_of_mine\n{text}")
        (tmp_path / name / "numbers_of_mine.py").write_text(f"M = {value}")
        (tmp_path / name / "helping").mkdir()
        (tmp_path / name / "helping" / "__init__.py").write_text("")
        (tmp_path / name / "helping" / "more.py").write_text("x = 1")
    path = list(sys.path)
    for name, value in (("one", 10.0), ("two", 20.0), ("one", 10.0)):
        plant = rl.plant(f"{name}/axis.py:axis")
        assert mass(plant) == value
        files = [
            f"{name}/{file}" for file in ("axis.py", "helping/__init__.py", "helping/more.py", "numbers_of_mine.py")
        ]
        assert sorted(plant.provenance.inputs) == files
        content = (tmp_path / name / "numbers_of_mine.py").read_bytes()
        assert plant.provenance.inputs[f"{name}/numbers_of_mine.py"] == hashlib.sha256(content).hexdigest()
    assert sys.path == path


def test_a_changed_file_is_run_again(folder):
    assert mass(rl.plant("axis.py:axis")) == 95.0
    (folder / "axis.py").write_text(AXIS.replace("95.0", "90.0"))
    assert mass(rl.plant("axis.py:axis")) == 90.0


def test_a_data_file_runs_no_code(folder):
    """A plant's name in an HDF5 file is looked up among those that come with robustlab, and nowhere else."""
    (folder / "evil.py").write_text("from pathlib import Path\nPath('was-run').touch()\nfrom axis import axis\n")
    rl.save("motor.h5", rl.plant("dc-motor"))
    tree = read_tree("motor.h5")
    tree.groups["plant"].attrs["name"] = "evil.py:axis"
    for name in ("format", "format_version", "kind", "content_sha256"):
        tree.attrs.pop(name, None)
    stamp(tree, "plant", Provenance.now("evil"))
    write_tree("motor.h5", tree)
    with pytest.raises(InputError, match="no such plant"):
        rl.load("motor.h5")
    with pytest.raises(InputError, match="no such plant"):
        builtin_plant("evil.py:axis")
    assert not (folder / "was-run").exists()


# --- faulty files -----------------------------------------------------------------------------------------------------

PLANT = "import robustlab as rl\n"
FAULTS = {
    "no Python": ("def axis(:\n", "bad.py, line 1: not valid Python: "),
    "bytes": (b"\xff\xfe\x00\x01", "bad.py"),
    "empty": ("", "bad.py: no plant 'axis' in it, expected a file that defines a plant"),
    "raises at import": ("x = 1\ny = x / 0\n", "bad.py, line 2: ZeroDivisionError: division by zero"),
    "raises in a module next to it": ("import neighbour\n", "neighbour.py, line 2: KeyError: 'nothing'"),
    "no Python in a module next to it": ("import torn\n", "torn.py, line 1: not valid Python: "),
    "raises in the function": (
        "def axis():\n    return [][1]\n", "bad.py, line 2: IndexError: list index out of range"),
    "calls itself": ("def axis():\n    return axis()\n", "bad.py, line 2: RecursionError: maximum recursion depth"),
    "ends the program": ("import sys\nsys.exit(0)\n", "bad.py, line 2: ends the program (sys.exit(0)), expected code"),
    "asks for an argument": ("def axis(mass):\n    pass\n", "bad.py:axis: TypeError: axis() missing 1 required"),
    "returns nothing": ("def axis():\n    pass\n", "bad.py:axis: returned None, expected a plant"),
    "is something else": ("axis = [1, 2]\n", "bad.py:axis: a list, expected a plant, or a function that returns one"),
    "has another name": (PLANT + "axle = rl.plant('dc-motor')\n", "bad.py: no plant 'axis' in it, expected one of"),
    "names another that is not there": (
        PLANT + "axis = rl.plant('lost.py:axis')\n", "bad.py, line 2: lost.py: no such file"),
    "imports what is not there": (
        "x = 1\nimport pandass_of_mine\n",
        "bad.py, line 2: ModuleNotFoundError: No module named 'pandass_of_mine'\nhint: install it, or put"),
    "a parameter that physics forbids": (
        "from robustlab.dynamics import Parameter\nM = Parameter('M', -1.0, 'kg', sign='positive')\n",
        "bad.py, line 2: parameter 'M': -1 kg, expected a positive value"),
}  # fmt: skip
EQUATIONS = {
    "E=[[1, 0], [0, p['M']]]": {
        "E=[[1, 0], [0, p['m']]]": "KeyError: 'm'",
        "E=[[1, 0, 0], [0, p['M'], 0]]": "axis: equations: E is (2, 3), expected (2, 2)",
        "E=[[1, 0], [0]]": "axis: equations: E is no matrix of numbers, expected (2, 2)",
        "E=[[1, 0], [0, 1j]]": "axis: equations: E is no matrix of numbers",
        "E=[[1, 0], [0, p['M'] ** 2]]": "axis: equations: E is not affine in the parameters",
        "E=[[1, 0], [0, 1 / p['M']]]": "axis: equations: a division by a parameter",
        "E=[[1, 0], [0, 0 * p['M']]]": "axis: equations: E is singular",
        "E=[[1, 0], [0, float('nan')]]": "axis: equations: E has NaN or infinite entries",
    },
    "return Descriptor(": {"return list(": "TypeError: list() takes no keyword arguments", "return str(": ""},
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_faulty_file_gives_one_line(tmp_path, monkeypatch, fault):
    content, expected = FAULTS[fault]
    monkeypatch.chdir(tmp_path)
    (tmp_path / "neighbour.py").write_text("x = {}\nx['nothing']\n")
    (tmp_path / "torn.py").write_text("x = (\n")
    (tmp_path / "bad.py").write_bytes(content if isinstance(content, bytes) else content.encode())
    modules = set(sys.modules)
    with pytest.raises(InputError) as caught:
        rl.plant("bad.py:axis")
    assert str(caught.value).startswith(expected)
    assert "\n" not in caught.value.line
    assert not {"neighbour", "torn"} & (set(sys.modules) - modules)


@pytest.mark.parametrize(("right", "wrong"), [(right, wrong) for right in EQUATIONS for wrong in EQUATIONS[right]])
def test_wrong_equations_give_the_line_that_uses_them(folder, right, wrong):
    text = AXIS.replace('"', "'").replace(right, wrong)
    assert text != AXIS.replace('"', "'")
    (folder / "axis.py").write_text(text)
    with pytest.raises(InputError, match=r"^axis\.py, line \d+: ") as caught:
        rl.plant("axis.py:axis")
    assert EQUATIONS[right][wrong] in str(caught.value)


def test_the_nearest_name_is_proposed(folder):
    with pytest.raises(InputError, match=r"did you mean axis\?"):
        rl.plant("axis.py:axs")
    with pytest.raises(InputError, match=r"did you mean axis\.py\?"):
        rl.plant("axsi.py:axis")
    with pytest.raises(InputError, match=r"no such parameter.*\n.*did you mean Fv\?") as caught:
        rl.plant("axis.py:axis", Fvv=3.0)
    assert caught.value.line.startswith("axis.py, line ")


def test_a_missing_optional_package_is_named_with_its_extra(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "casadi", None)  # as if it were not installed
    (folder / "cart.py").write_text("import robustlab as rl\nimport casadi as ca\n")
    with pytest.raises(DependencyMissing) as caught:
        rl.plant("cart.py:cart")
    assert str(caught.value) == "cart.py, line 2: needs casadi\nhint: pip install 'robustlab[casadi]'"
    assert caught.value.exit_code == 5


OWN = """
import numpy as np
from robustlab.dynamics import NonlinearPlant, Parameter, Trim
from robustlab.statespace import Signal


class Pendulum(NonlinearPlant):
    def derivative(self, x, u):
        return {derivative}

    def output(self, x, u):
        return {output}

    def jacobians(self, x, u):
        raise NotImplementedError

    def equilibrium(self, **where):
        raise NotImplementedError

    def with_parameters(self, **given):
        raise NotImplementedError


pendulum = Pendulum("p", {{}}, (Signal("u", "N m"),), (Signal("a", "rad"),), (Signal("a", "rad"), Signal("w", "rad/s")))
"""


@pytest.mark.parametrize(
    ("derivative", "output", "expected"),
    [
        ("np.array([x[1], u[0] - np.sin(x[0])])", "x[:1]", ""),
        ("np.array([x[1]])", "x[:1]", r"derivative\(x, u\) has the shape \(1,\), expected \(2,\)"),
        ("np.array([x[1], u[0]])", "x", r"output\(x, u\) has the shape \(2,\), expected \(1,\)"),
        ("np.array([x[2], u[0]])", "x", r"own.py, line 9: IndexError"),
        ("np.array([1.0 / float(x[0]), u[0]])", "x[:1]", ""),  # not defined at zero, which is no fault
    ],
)
def test_a_plant_of_a_user_class(folder, derivative, output, expected):
    (folder / "own.py").write_text(OWN.format(derivative=derivative, output=output))
    if not expected:
        assert rl.plant("own.py:pendulum").derivative([0.1, 0.2], [0.0])[0] in (0.2, 10.0)
        return
    with pytest.raises(InputError, match=expected):
        rl.plant("own.py:pendulum")


@pytest.mark.parametrize("name", ["folder.py", "x" * 300 + ".py", "a\0b.py", "missing/axis.py"])
def test_paths_that_are_no_files(folder, name):
    (folder / "folder.py").mkdir()
    with pytest.raises(InputError):
        rl.plant(f"{name}:axis")
