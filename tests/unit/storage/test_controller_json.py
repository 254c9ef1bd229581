"""Controllers as JSON: what is read back is what was written, bit by bit; every fault has its name in one line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import robustlab as rl
from robustlab.statespace import OperatingPoint
from robustlab.storage import read

numbers = st.floats(allow_nan=False, allow_infinity=False, width=64)


@given(st.data(), st.integers(0, 3), st.integers(1, 3), st.integers(1, 3), st.sampled_from([0.0, 1e-3, 0.1]))
@settings(max_examples=40, deadline=None)
def test_what_is_read_is_what_was_written(tmp_path_factory, data, n, m, p, dt):
    def matrix(rows, columns):
        flat = data.draw(st.lists(numbers, min_size=rows * columns, max_size=rows * columns))
        return np.array(flat, dtype=float).reshape(rows, columns)

    units = data.draw(st.lists(st.sampled_from(["", "rad", "N m", "µm", '"]']), min_size=m, max_size=m))
    inputs = [(f"y{i}\u00e9\n", unit) for i, unit in enumerate(units)]
    K = rl.StateSpaceModel(matrix(n, n), matrix(n, m), matrix(p, n), matrix(p, m), dt, inputs)
    gamma = data.draw(st.none() | st.floats(0, allow_nan=False))
    held = rl.Controller(K, gamma, data.draw(st.sampled_from(list(rl.Status))), "dk")
    again = rl.load(rl.export_controller(tmp_path_factory.mktemp("k") / "k.json", held))
    assert isinstance(again, rl.Controller)
    for name in "ABCD":
        one, two = getattr(again.K, name), getattr(K, name)
        assert one.shape == two.shape
        assert one.tobytes() == two.tobytes()  # the sign of a zero as well
    assert (again.K.dt, again.K.inputs, again.K.outputs, again.K.states) == (K.dt, K.inputs, K.outputs, K.states)
    assert (again.gamma, again.status, again.method) == (gamma, held.status, "dk")


def test_operating_point_provenance_and_saturation(tmp_path):
    point = OperatingPoint(np.array([1.0]), np.array([2.0, -0.0]), np.array([1e-300]))
    K = rl.StateSpaceModel([[0.5]], [[1.0, 2.0]], [[3.0]], [[0.0, 1.0]], 0.1, operating_point=point)
    path = rl.export_controller(tmp_path / "k.json", K, saturation=(-1.0, 1.0))
    loaded = read(path)
    assert loaded.kind == "controller"
    assert not loaded.verified
    assert any("saturation" in text for text in loaded.warnings)
    assert loaded.provenance.created_by == "export_controller"
    found = loaded.object.K.operating_point
    assert all(getattr(found, name).tobytes() == getattr(point, name).tobytes() for name in ("x", "u", "y"))


def written(tmp_path, change):
    K = rl.StateSpaceModel([[0.5]], [[1.0, 2.0]], [[3.0]], [[0.0, 1.0]], 0.1)
    path = rl.export_controller(tmp_path / "k.json", K)
    data = json.loads(path.read_text())
    text = change(data)
    path.write_text(text if isinstance(text, str) else json.dumps(data))
    return path


def put(key, value):
    return lambda data: data.update({key: value})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (put("A", [[float("nan")]]), "NaN is among the numbers"),
        (put("A", [[float("inf")]]), "Infinity is among the numbers"),
        (put("A", [["nan"]]), r"A\[0,0\]: 'nan', expected a number"),
        (put("A", [[True]]), r"A\[0,0\]: True"),
        (put("A", [[10**400]]), r"A\[0,0\]: a number too large"),
        (put("A", [[0.5, 1.0]]), "A: 1 x 2, expected 1 x 1"),
        (put("B", [[1.0], [2.0]]), "B: 2 x 1, expected 1 x 2"),
        (put("D", [[0.0, 1.0], [1.0]]), "D: rows of 1 to 2 numbers, expected 1 x 2"),
        (put("C", 3.0), "C: 3.0, expected a list of rows"),
        (put("dt", -0.1), "dt"),
        (put("dt", "0.1"), "dt: '0.1', expected a number"),
        (put("inputs", [{"name": "a"}]), "B: 1 x 2, expected 1 x 1"),
        (put("inputs", [{"name": "a"}, {"name": "a"}]), "used twice"),
        (put("inputs", [{"name": "a", "units": "m"}, {"name": "b"}]), r"inputs\[0\]"),
        (put("outputs", "u"), "outputs: a str"),
        (put("status", "proved"), "status: 'proved', expected one of certified"),
        (put("gamma", "small"), "gamma: 'small'"),
        (put("method", 3), "method: 3"),
        (put("operating_point", {"x": [1.0]}), "operating_point"),
        (put("operating_point", {"x": [1.0], "u": [1.0], "y": [1.0]}), r"u: \[1.0\], expected a list of 2"),
        (put("provenance", 7), "provenance: 7"),
        (put("schema", "robustlab.result/1"), "schema 'robustlab.result/1', expected robustlab.controller/1"),
        (put("schema", "robustlab.controller/2"), "version '2', expected version 1"),
        (put("schema", 1), "schema 1"),
        (put("gama", 1.0), "unknown key 'gama'"),
        (lambda data: data.pop("schema") and None, "no schema"),
        (lambda data: data.pop("D") and None, "missing D"),
        (lambda _: "[1, 2]", "JSON of a list"),
        (lambda _: "{", "not valid JSON: .*line 1"),
        (lambda _: '{"schema": 1, "schema": 2}', "'schema' is written twice"),
        (lambda _: '{"a":' * 5000, "not valid JSON|nested too deeply"),
        (lambda _: "[" * 100_000, "nested too deeply"),
        (lambda _: '{"a": ' + "9" * 5000 + "}", "number too long"),
    ],
)
def test_faults_are_named(tmp_path, change, words):
    path = written(tmp_path, change)
    with pytest.raises(rl.InputError, match=words) as caught:
        rl.load(path)
    assert str(caught.value).splitlines()[0].startswith(str(path))
    assert len(str(caught.value).splitlines()) <= 2  # the second line is a hint


def test_a_newer_version_says_what_to_do(tmp_path):
    with pytest.raises(rl.InputError, match="upgrade"):
        rl.load(written(tmp_path, put("schema", "robustlab.controller/2")))


def test_groups_and_transposition_are_not_taken(tmp_path):
    path = written(tmp_path, lambda _: None)
    for options in ({"group": "K"}, {"transpose": True}):
        with pytest.raises(rl.InputError, match="JSON"):
            rl.load(path, **options)


def test_bytes_that_are_no_text(tmp_path):
    path = tmp_path / "k.json"
    path.write_bytes(b'{"schema": "\xff"}')
    with pytest.raises(rl.InputError, match="byte 12 is not UTF-8"):
        rl.load(path)
