"""The archive and its description are untrusted: what is wrong with them is one line, and nothing leaves the folder."""

from __future__ import annotations

import hashlib
import shutil
import signal
import stat
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import fmu_units as units
import pytest
from fmu_units import needs_compiler
from patience import PATIENCE

import robustlab as rl
from robustlab.dynamics.fmu.description import read_description, unpack

XML = units.description(2)
COMMAND = [sys.executable, "-c", "from robustlab.cli.main import main; main()"]


def described(tmp_path, xml):
    return read_description(str(units.packed(tmp_path / "x.fmu", xml)), "x.fmu")


@pytest.mark.parametrize("version", [2, 3])
def test_a_description_names_signals_parameters_and_joints(tmp_path, version):
    about = described(tmp_path, units.description(version, joint=True, events=True, directional=False))
    assert [v["name"] for v in about["states"]] == ["q", "v"]
    assert about["rates"] == [2, 3]
    assert [p["name"] for p in about["parameters"]] == list(units.PARAMETERS)
    assert about["joints"] == [{"velocity": "v", "position": "q", "input": "F"}]
    assert about["indicators"] == 1
    assert not about["kinds"]["model-exchange"]["directional"]


WRONG = {
    "FMI version 1.0": XML.replace('fmiVersion="2.0"', 'fmiVersion="1.0"'),
    "a document type declaration": '<!DOCTYPE a [<!ENTITY e SYSTEM "file:///etc/passwd">]>'
    + XML.replace('unit="kg"', 'unit="&e;"'),
    "is no XML": XML[:-40],
    "neither model exchange": XML.replace("<ModelExchange", "<Other").replace("<CoSimulation", "<Other"),
    "a number that is none": XML.replace('start="8.0"', 'start="eight"'),
    "names variable number 99": XML.replace('<Unknown index="3"/>', '<Unknown index="99"/>'),
    "model identifier": XML.replace('modelIdentifier="unit"', 'modelIdentifier="../unit"'),
    "<html>": "<html/>",
    "without value reference": XML.replace('valueReference="0" ', ""),
    "q is an array": units.description(3).replace(
        'start="0.5" unit="m"/>', 'start="0.5" unit="m"><Dimension start="3"/></Float64>'
    ),
    "clocks": units.description(3).replace("<ModelVariables>", '<ModelVariables><Clock name="c" valueReference="7"/>'),
}  # fmt: skip


@pytest.mark.parametrize("message", WRONG)
def test_a_wrong_description_is_refused(tmp_path, message):
    with pytest.raises(rl.InputError, match=message):
        described(tmp_path, WRONG[message])


def test_entities_in_another_encoding_are_refused_too(tmp_path):
    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("modelDescription.xml", ("<!DOCTYPE a>" + XML).encode("utf-16"))
    with pytest.raises(rl.InputError, match="document type"):
        read_description(str(path), "x.fmu")


def test_a_damaged_archive_is_one_line_with_exit_code_3(tmp_path):
    whole = units.packed(tmp_path / "whole.fmu", XML)
    raw = whole.read_bytes()
    cut = tmp_path / "cut.fmu"
    for text, message in (
        (raw[: len(raw) // 2], "no whole zip archive"),
        (b"hello", "no whole zip archive"),
        (raw.replace(b"mass-on-spring", b"mess-on-spring", 1), "cannot be unpacked"),
    ):
        cut.write_bytes(text)
        with pytest.raises(rl.InputError, match=message) as caught:
            rl.plant(str(cut))
        assert "\n" not in caught.value.line
    with zipfile.ZipFile(cut, "w") as archive:
        archive.writestr("other.xml", XML)
    with pytest.raises(rl.InputError, match=r"without modelDescription.xml"):
        rl.plant(str(cut))
    with pytest.raises(rl.InputError, match="no such file"):
        rl.plant(str(tmp_path / "none.fmu"))


def test_nothing_is_unpacked_out_of_the_folder(tmp_path):
    for k, name in enumerate(("../out.txt", "/tmp/out.txt", "a/../../out.txt", "a\\..\\out.txt", "C:/out.txt")):
        path = tmp_path / f"{k}.fmu"
        with zipfile.ZipFile(path, "w") as archive:
            info = zipfile.ZipInfo("x")
            info.filename = name
            archive.writestr(info, "out")
        with pytest.raises(rl.InputError, match="lead out"):
            unpack(str(path), "x.fmu", str(tmp_path / "home"))
    link = zipfile.ZipInfo("link")
    link.external_attr = (stat.S_IFLNK | 0o777) << 16
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr(link, "/etc")
    with pytest.raises(rl.InputError, match="lead out"):
        unpack(str(path), "x.fmu", str(tmp_path / "home"))
    assert not (tmp_path / "out.txt").exists()


def test_sizes_are_limited_before_anything_is_unpacked(tmp_path, monkeypatch):
    from robustlab.dynamics.fmu import description

    path = tmp_path / "x.fmu"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("modelDescription.xml", XML)
        archive.writestr("zeros", bytes(1 << 20))
    monkeypatch.setattr(description, "MOST_BYTES", 1 << 20)
    with pytest.raises(rl.InputError, match="bytes unpacked"):
        description.read_description(str(path), "x.fmu")
    monkeypatch.setattr(description, "MOST_BYTES", 1 << 22)
    monkeypatch.setattr(description, "LARGEST_XML", 100)
    with pytest.raises(rl.InputError, match="at most 100"):
        description.read_description(str(path), "x.fmu")


def test_a_library_that_is_none_or_not_there(tmp_path):
    with pytest.raises(rl.InputError, match="its library cannot be loaded"):
        rl.plant(str(units.packed(tmp_path / "x.fmu", XML)))
    rubbish = tmp_path / "rubbish.so"
    rubbish.write_bytes(b"\x7fELF" + bytes(100))
    with pytest.raises(rl.InputError, match="its library cannot be loaded"):
        rl.plant(str(units.packed(tmp_path / "x.fmu", XML, rubbish)))


@needs_compiler
def test_what_the_unit_prints_does_not_reach_the_command_line(unit):
    command = [*COMMAND, "plant", "show", unit(2), "--set", "fault=4"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "noise" not in done.stdout + done.stderr
    assert "-0.1+1.99" in done.stdout.replace(" ", "")


@needs_compiler
@pytest.mark.parametrize(("fault", "code"), [(1, 4), (6, 4)])
def test_the_command_line_ends_with_one_line_and_the_code(unit, fault, code):
    command = [*COMMAND, "plant", "show", unit(2), "--set", f"fault={fault}", "--at", "F=0"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == code
    assert "Traceback" not in done.stderr


@needs_compiler
@pytest.mark.skipif(not Path("/proc").exists(), reason="looks for the child in /proc")
def test_the_child_does_not_outlive_its_parent_even_while_it_hangs(unit, tmp_path):
    code = (
        "import robustlab as rl, sys, threading\n"
        f"p = rl.plant({unit(2)!r})\n"
        "print(p.process._child.pid, flush=True)\n"
        "p.with_parameters(fault=2).derivative([0, 0], [0])\n"
    )
    parent = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    child = int(parent.stdout.readline())
    folder = Path(f"/proc/{child}/cwd").readlink()
    time.sleep(0.3)
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    parent.stdout.close()
    until = time.monotonic() + PATIENCE
    while (Path(f"/proc/{child}").exists() or Path(folder).exists()) and time.monotonic() < until:
        time.sleep(0.05)
    assert not Path(f"/proc/{child}").exists()
    assert not Path(folder).exists()


@needs_compiler
def test_a_data_file_never_runs_a_unit(unit, tmp_path):
    """The name of a plant in a data file is that of a built-in plant or nothing."""
    path = rl.save(tmp_path / "plant.h5", rl.plant("mass-spring-damper", m=2.0, c=0.4, k=8.0))
    import h5py

    with h5py.File(path, "r+") as file:
        file["plant"].attrs["name"] = unit(2)
    with pytest.raises(rl.InputError):
        rl.load(path)


@needs_compiler
def test_a_recipe_names_a_unit_and_keeps_its_hash(unit, tmp_path):
    shutil.copy(unit(2), tmp_path / "machine.fmu")
    steps = '[step.axis]\ndo = "plant"\nplant = "machine.fmu"\nparameters = { m = 4.0 }\n'
    steps += '[step.model]\ndo = "linearise"\nof = "axis"\n'
    (tmp_path / "axis.toml").write_text(f'schema = "robustlab.recipe/1"\nname = "axis"\n{steps}')
    command = [*COMMAND, "run", "axis.toml", "--out", "out"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stdout + done.stderr
    digest = hashlib.sha256((tmp_path / "machine.fmu").read_bytes()).hexdigest()
    results = "".join(f.read_text() for f in (tmp_path / "out").rglob("*.json"))
    assert digest in results
