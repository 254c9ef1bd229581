"""``robustlab worst-case``: what it prints, writes and returns."""

from __future__ import annotations

import json

import pytest

from robustlab.cli.ending import main_guard
from robustlab.cli.uncertain import app as uncertain
from robustlab.cli.worst_case import app
from robustlab.storage import load


def call(capsys, *arguments):
    code = main_guard(lambda: app(args=list(arguments), standalone_mode=False))
    done = capsys.readouterr()
    return code, done.out, done.err


@pytest.fixture(scope="module")
def motor(tmp_path_factory):
    path = str(tmp_path_factory.mktemp("motor") / "motor.h5")
    arguments = ["build", "--plant", "dc-motor", "--tolerance", "Kf=0.35", "--out", path]
    assert main_guard(lambda: uncertain(args=arguments, standalone_mode=False)) == 0
    return path


def test_peak_deviation(motor, capsys):
    code, text, err = call(capsys, motor, "--outputs", "omega", "--input-value", "u=42", "--t-end", "0.1")
    assert (code, err) == (0, "")
    assert "peak-deviation                  9.78578 rad/s" in text
    assert "lower bound" in text
    assert "3.12e-05 N m s/rad" in text


def test_json_and_file(motor, tmp_path, capsys):
    out = str(tmp_path / "worst.h5")
    code, text, _ = call(capsys, motor, "--metric", "hinf", "--outputs", "omega", "--json", "--out", out)
    data = json.loads(text)
    assert code == 0
    assert (data["status"], data["delta"]) == ("converged", {"Kf": -1.0})
    # The gain of a motor is largest at standstill of the input: Km / (R Kf + Km Kb) with Kf at its lowest.
    assert data["value"] == pytest.approx(0.052 / (2.07 * 0.65 * 4.8e-5 + 0.052**2), rel=1e-6)
    assert load(out).data["value"] == pytest.approx(data["value"])


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        ((), 2, "3 outputs and none named"),
        (("--metric", "peek-deviation"), 2, "did you mean peak-deviation?"),
        (("--metric", "hinf", "--outputs", "speed"), 3, "no such signal"),
        (("--metric", "hinf"), 4, "not asymptotically stable"),
    ],
)
def test_refusals(motor, options, code, text, capsys):
    found, out, err = call(capsys, motor, *options)
    assert (found, out) == (code, "")
    assert text in err


def test_time_limit_ends_in_four(motor, capsys):
    code, text, _ = call(capsys, motor, "--metric", "hinf", "--outputs", "omega", "--time-limit", "0")
    assert code == 4
    assert "WorstCase (timeout)" in text
    assert "not repeatable" in text


def test_probability_of_a_violation(motor, tmp_path, capsys):
    """9.3 rad/s of 9.7858: the slowest friction alone passes it, Kf below about -0.95 of its range."""
    drive = ("--outputs", "omega", "--input-value", "u=42", "--t-end", "0.1", "--seed", "3")
    out = str(tmp_path / "p.h5")
    folder = f"{tmp_path / 'figures'}/"
    code, text, err = call(
        capsys, motor, "--limit", "9.3 rad/s", "-n", "500", "--figure", folder, "--out", out, "--json", *drive
    )
    data = json.loads(text)
    assert code == 0
    assert err.count("written: ") == 4
    assert data["lower"] < data["probability"] < data["upper"] < 0.1
    assert data["influence"]["order"] == ["Kf"]
    assert len(list((tmp_path / "figures").iterdir())) == 4
    assert load(out).data["violations"] == data["violations"]
    code, text, _ = call(capsys, motor, "--limit", "12", "--probability", "0.05", *drive)
    assert code == 0
    assert "without a unit" in text
    assert "shown at 95 % (59 samples" in text
    code, text, _ = call(capsys, motor, "--limit", "2 rad/s", "--probability", "0.05", *drive)
    assert code == 1
    assert "not shown" in text


@pytest.mark.parametrize("metric", ["rms", "settling-time", "h2", "damping"])
def test_other_metrics(motor, metric, capsys):
    code, text, _ = call(
        capsys, motor, "--metric", metric, "--outputs", "omega", "--inputs", "u", "--t-end", "0.1", "-n", "8"
    )
    assert code == 0
    assert text.splitlines()[1].startswith(f"  {metric} ")
    assert "sampled" in text


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        (("--limit", "9 rad", "--outputs", "omega"), 3, "in rad, expected rad/s"),
        (("--limit", "nan", "--outputs", "omega"), 3, "a finite number"),
        (("--limit", "9", "--outputs", "omega", "-n", "0"), 3, "samples from 1"),
        (("--probability", "0.1", "--outputs", "omega"), 2, "with --limit only"),
        (("--limit", "9", "--outputs", "omega", "--confidence", "95"), 3, "between 0 and 1"),
    ],
)
def test_refusals_of_limits(motor, options, code, text, capsys):
    found, out, err = call(capsys, motor, *options, "--input-value", "u=42", "--t-end", "0.1")
    assert (found, out) == (code, "")
    assert text in err
