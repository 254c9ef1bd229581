"""Units and percentages on the command line and in recipes: ``5%``, ``42V``, ``--unit phi=deg``."""

import json
import math

import numpy as np
import pytest
from shell import robustlab

import robustlab as rl


@pytest.fixture(autouse=True)
def in_its_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def call(*words, code=0):
    """Return the output of the command, or its error."""
    ending = robustlab(*words, code=code)
    return ending.out if code == 0 else ending.err


def block(text, name):
    (found,) = [b for b in json.loads(text)["blocks"] if b["name"] == name]
    return found["parameter"]


# --- tolerances -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("text", ["Km=5%", "Km=0.05", "Km=5 %"])
def test_a_tolerance_per_cent(text):
    found = block(call("uncertain", "plant", "dc-motor", "--tolerance", text, "--json"), "Km")
    assert (found["nominal"], found["radius"]) == pytest.approx((0.052, 0.0026), rel=1e-14)


def test_a_range_with_units():
    words = ("uncertain", "plant", "dc-motor", "--range", "Km=40 mN m/A:0.06 N m/A", "--json")
    found = block(call(*words), "Km")
    low = found["nominal"] - found.get("below", found["radius"])
    assert (low, found["nominal"] + found["radius"]) == pytest.approx((0.04, 0.06))


def test_a_parameter_and_an_input_with_their_units(tmp_path):
    call("model", "build", "dc-motor", "--set", "R=2100 mohm", "--out", "a.h5")
    call("model", "build", "dc-motor", "--set", "R=2.1", "--out", "b.h5")
    assert (rl.load(tmp_path / "a.h5").A == rl.load(tmp_path / "b.h5").A).all()
    rl.save(tmp_path / "u.h5", rl.plant("dc-motor").uncertain(["omega"]))


RECIPE = """
schema = "robustlab.recipe/1"
name = "small"
[step.motor]
do = "plant"
plant = "dc-motor"
parameters = {{ R = "2.1 ohm", L = ["0.6 mH", "10%"] }}
[step.set]
do = "uncertain"
of = "motor"
tolerances = {{ Km = {km}, Kf = "35%" }}
"""


def test_tolerances_and_units_in_a_recipe(tmp_path):
    (tmp_path / "r.toml").write_text(RECIPE.format(km='"5%"'))
    call("run", "r.toml", "--set", "set.tolerances.J=10%", "--out", "out/small")
    motor, made = json.loads((tmp_path / "out/small/result.json").read_text())["steps"]
    found = motor["numbers"]["parameters"]
    assert (found["R"]["value"], found["L"]["value"], found["L"]["tolerance"]) == (2.1, pytest.approx(6e-4), 0.1)
    blocks = next(fact["value"] for fact in made["facts"] if fact["label"] == "3 blocks")
    assert blocks.startswith("Km 0.0494 .. 0.0546 N m/A, Kf 3.12e-05 .. 6.48e-05 N m s/rad, J 6.48e-06 .. 7.92e-06")
    (tmp_path / "r.toml").write_text(RECIPE.format(km="5"))
    assert "did you mean 5% = 0.05?" in call("recipe", "check", "r.toml", code=3)
    (tmp_path / "r.toml").write_text(RECIPE.format(km='"5 V"'))
    assert 'a share of the value: 0.05, or "5%"' in call("recipe", "check", "r.toml", code=3)
    (tmp_path / "r.toml").write_text(RECIPE.format(km="0.05").replace("0.6 mH", "0.6 mm"))
    assert "'0.6 mm', expected a number in H" in call("run", "r.toml", code=3)


def test_tolerances_of_a_discovery_may_be_per_cent():
    from robustlab.identification import stated_tolerances

    found = stated_tolerances(rl.plant("dc-motor"), {"Km": "5%", "Kf": 2.0})
    assert (found["Km"], found["Kf"]) == ((0.05, False), (2.0, False))
    with pytest.raises(rl.InputError, match="expected a share"):
        stated_tolerances(rl.plant("dc-motor"), {"Km": "5 V"})


# --- units of records -------------------------------------------------------------------------------------------------

T = np.arange(40) * 0.01
MEASURED = {"phi": 90 * np.sin(T), "omega": 60 * np.cos(T), "q": 5.0 + T, "n": np.round(100 * T)}
UNITS = ["phi=deg", "omega=rpm", "q=mm", "n=counts"]
IN_SI = {
    "phi": (math.pi / 180, "rad"),
    "omega": (2 * math.pi / 60, "rad/s"),
    "q": (1e-3, "m"),
    "n": (1.0, "counts"),
}


def write(path, stated):
    """The measured numbers as text or HDF5, with the units in the file or without."""
    names = dict(zip(MEASURED, ("°", "1/min", "mm", ""), strict=True)) if stated else dict.fromkeys(MEASURED, "")
    if path.suffix == ".csv":
        header = ",".join(["t", *(f"{name} [{unit}]" if unit else name for name, unit in names.items())])
        np.savetxt(
            path, np.column_stack([T, *MEASURED.values()]), delimiter=",", header=header, comments="", fmt="%.17g"
        )
    elif path.name.startswith("plain"):
        import h5py

        with h5py.File(path, "w") as file:
            file["t"] = T
            for name, values in MEASURED.items():
                file[name] = values
                file[name].attrs["unit"] = names[name]
    else:
        rl.save(path, rl.Record(T, {}, MEASURED, names))


@pytest.mark.parametrize("stated", [False, True])
@pytest.mark.parametrize("file", ["r.csv", "r.h5", "plain.h5"])
def test_a_unit_given_converts_to_si(tmp_path, file, stated):
    write(tmp_path / file, stated)
    options = [word for unit in UNITS for word in ("--unit", unit)]
    call("data", "convert", file, "si.h5", *options)
    record = rl.load(tmp_path / "si.h5")
    for name, (factor, unit) in IN_SI.items():
        assert record.unit(name) == unit
        np.testing.assert_allclose(record[name], MEASURED[name] * factor, rtol=1e-15)
    channels = {c["name"]: c for c in json.loads(call("data", "check", file, *options, "--json"))["channels"]}
    assert channels["phi"]["unit"] == "rad"
    assert channels["phi"]["greatest"] == pytest.approx(math.pi / 2 * math.sin(0.39), rel=1e-12)
    read = rl.Record.read(tmp_path / file, units={"phi": "deg"})
    np.testing.assert_array_equal(read["phi"], record["phi"])
    np.testing.assert_array_equal(read["omega"], MEASURED["omega"])  # what is not named stays as it is


@pytest.mark.parametrize("file", ["r.csv", "r.h5", "plain.h5"])
def test_a_unit_that_contradicts_the_file_is_refused(tmp_path, file):
    write(tmp_path / file, stated=True)
    message = call("data", "check", file, "--unit", "q=m", code=3)
    assert "q: the file states mm, the unit given is m" in message
    assert "hint: --unit q=mm converts from it" in message
    assert "a unit for 'phj'" in call("data", "check", file, "--unit", "phj=deg", code=3)


def test_a_record_in_degrees_is_compared_with_a_model_in_radians(tmp_path):
    t = np.arange(200) * 1e-3
    clean = rl.simulate(rl.plant("dc-motor"), t, 10 * np.sin(40 * t))
    columns = np.column_stack([t * 1e3, clean["u"], np.degrees(clean["phi"])])
    np.savetxt(tmp_path / "m.csv", columns, delimiter=",", header="t,u,phi", comments="", fmt="%.17g")
    units = ("--unit", "t=ms", "--unit", "phi=deg")
    ending = call("data", "compare", "dc-motor", "m.csv", "--outputs", "phi", *units, "--json")
    found = json.loads(ending)["outputs"]["phi"]
    assert (found["unit"], found["fit"] > 99.99) == ("rad", True)
    (tmp_path / "m.toml").write_text("""
schema = "robustlab.recipe/1"
name = "m"
[step.measured]
do = "record"
path = "m.csv"
inputs = ["u"]
units = { t = "ms", phi = "deg" }
""")
    call("run", "m.toml")
    (step,) = json.loads((tmp_path / "out/m/result.json").read_text())["steps"]
    assert step["numbers"]["duration"] == pytest.approx(0.199)
    assert any("phi [rad]" in fact["value"] for fact in step["facts"])
