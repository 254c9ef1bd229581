"""Octave's own ``save -hdf5``: laid out here with h5py as Octave 7.3 writes it, byte types and all."""

import h5py
import numpy as np
import pytest

import robustlab as rl
from robustlab.files.hdf5 import read_tree
from robustlab.files.tree import Unread
from robustlab.storage import load_pair


def octave(group, name, value):
    """One variable as Octave stores it: type and value in a group, matrices with their axes reversed."""
    held = group.create_group(name)
    held.attrs["OCTAVE_NEW_FORMAT"] = np.uint8(1)
    if isinstance(value, dict):
        kind = "scalar struct"
        inner = held.create_group("value")
        for key, item in value.items():
            octave(inner, key, item)
    elif isinstance(value, list):
        kind = "cell"
        inner = held.create_group("value")
        inner["dims"] = np.array([1, len(value)], np.int64)  # a column, its sizes reversed
        for i, item in enumerate(value):
            octave(inner, f"_{i}", item)
    elif isinstance(value, str):
        kind = "sq_string"
        held["value"] = np.frombuffer(value.encode(), np.int8).reshape(-1, 1)
    elif isinstance(value, range):
        kind = "double_range"
        stored = np.array((0.0, 2.0, 0.1), [("base", "<f8"), ("limit", "<f8"), ("increment", "<f8")])
        held["value"] = stored
        held["value"].attrs["OCTAVE_RANGE_NELEM"] = np.int64(21)
    else:
        kind = "scalar" if np.ndim(value) == 0 else "matrix"
        array = np.asarray(value, float)
        if array.size == 0:
            held["value"] = np.array(array.shape, np.int64)
            held.attrs["OCTAVE_EMPTY_MATRIX"] = np.uint8(1)
        else:
            held["value"] = array.T.copy()
    held.create_dataset("type", data=np.bytes_(kind), dtype=f"S{len(kind) + 1}")  # with its NUL


A, B, C = np.array([[0.0, 1.0], [-2.0, -3.0]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])


def test_a_model_is_read_as_it_stands_in_octave(tmp_path):
    with h5py.File(tmp_path / "p.h5", "w") as file:
        for name, value in {"A": A, "B": B, "C": C, "D": 0.5, "Ts": 0.1}.items():
            octave(file, name, value)
    model = rl.load(tmp_path / "p.h5")
    assert model.dt == 0.1
    for name, value in {"A": A, "B": B, "C": C, "D": [[0.5]]}.items():
        np.testing.assert_array_equal(getattr(model, name), value)


def test_structs_are_groups_and_pairs(tmp_path):
    system = {"A": A, "B": B, "C": C, "D": 0.0}
    with h5py.File(tmp_path / "p.h5", "w") as file:
        octave(file, "nominal", system)
        octave(file, "perturbed", {**system, "A": np.array([[0.0, 1.0], [-2.2, -3.0]])})
    np.testing.assert_array_equal(rl.load(tmp_path / "p.h5", group="nominal").A, A)
    assert load_pair(tmp_path / "p.h5")[1].A[1, 0] == -2.2


def test_a_record_with_a_range_as_its_clock(tmp_path):
    with h5py.File(tmp_path / "r.h5", "w") as file:
        octave(file, "t", range(21))
        octave(file, "q", np.arange(21.0).reshape(-1, 1))
    record = rl.load(tmp_path / "r.h5")
    np.testing.assert_allclose(record.t, np.linspace(0.0, 2.0, 21), rtol=0, atol=1e-15)
    np.testing.assert_array_equal(record["q"], np.arange(21.0))


def test_every_form(tmp_path):
    with h5py.File(tmp_path / "f.h5", "w") as file:
        octave(file, "text", "Kühlung")
        octave(file, "names", ["a", "bb"])
        octave(file, "mixed", ["a", 1.0])
        octave(file, "none", np.zeros((0, 3)))
        octave(file, "deep", {"in": {"x": 1.0}})
        octave(file, "page", np.arange(24.0).reshape(2, 3, 4))
        file["plain"] = [[1.0, 2.0]]  # not marked: as it lies
    tree = read_tree(tmp_path / "f.h5")
    values = {name: dataset.values for name, dataset in tree.datasets.items()}
    assert values["text"].tolist() == ["Kühlung"]
    assert values["names"].tolist() == [["a"], ["bb"]]
    assert isinstance(values["mixed"], Unread)
    assert values["none"].shape == (0, 3)
    np.testing.assert_array_equal(values["page"], np.arange(24.0).reshape(2, 3, 4))
    np.testing.assert_array_equal(values["plain"], [[1.0, 2.0]])
    assert tree.groups["deep"].groups["in"].path == "/deep/in"
    assert float(tree.groups["deep"].groups["in"].datasets["x"].values) == 1.0


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda g: g.attrs.__setitem__("OCTAVE_EMPTY_MATRIX", np.uint8(1)), "marked empty"),
        (lambda g: (g.__delitem__("type"), g.create_dataset("type", data=np.bytes_("sparse matrix"))), "sparse matrix"),
        (lambda g: (g.__delitem__("type"), g.create_dataset("type", data=np.bytes_("class"))), "Octave class"),
        (lambda g: g.__delitem__("value"), "Octave matrix"),
    ],
)
def test_other_contents_are_refused_by_name(tmp_path, change, word):
    with h5py.File(tmp_path / "p.h5", "w") as file:
        for name, value in {"A": A, "B": B, "C": C, "D": 0.5}.items():
            octave(file, name, value)
        change(file["A"])
    with pytest.raises(rl.InputError, match=rf"p\.h5: /A.*{word}"):
        rl.load(tmp_path / "p.h5")
