"""Files as MATLAB, Julia and python-control make and read them, made here by other programs than ours."""

import control
import h5py
import numpy as np
import pytest
import scipy.io
from record_files import matlab73

import robustlab as rl
from robustlab.errors import InputError
from robustlab.files import read_tree
from robustlab.storage import read

A = np.array([[-1.0, 2.0, 0.0], [0.0, -3.0, 1.0], [0.5, 0.0, -2.0]])
B = np.array([[1.0, 0.0], [0.0, 2.0], [3.0, 4.0]])
C = np.array([[1.0, 2.0, 3.0]])
D = np.array([[0.0, 5.0]])
MATRICES = {"A": A, "B": B, "C": C, "D": D}


def assert_model(model, dt=0.0):
    for name, value in MATRICES.items():
        np.testing.assert_array_equal(getattr(model, name), value)
    assert model.dt == dt


@pytest.mark.parametrize(("name", "isolate"), [("p.mat", True), ("p.mat", False), ("p.dat", False)])
def test_matlab_73(name, isolate, tmp_path):
    """The content decides, not the extension."""
    path = matlab73(tmp_path / name, {**MATRICES, "dt": 0.25, "note": "bench 3"})
    assert_model(rl.load(path, isolate=isolate), 0.25)


def test_matlab_73_pair_group_and_text(tmp_path):
    path = matlab73(tmp_path / "p.mat", {"nominal": MATRICES, "perturbed": {**MATRICES, "A": 2 * A}})
    nominal, perturbed = read(path).object
    assert_model(nominal)
    np.testing.assert_array_equal(perturbed.A, 2 * A)
    assert_model(rl.load(path, group="nominal"))
    tree = read_tree(matlab73(tmp_path / "q.mat", {"note": "Prüfstand"}), isolate=False)
    assert tree.datasets["note"].values.tolist() == ["Prüfstand"]


def test_matlab_73_static_gain(tmp_path):
    empty = {"A": np.zeros((0, 0)), "B": np.zeros((0, 2)), "C": np.zeros((3, 0)), "D": np.ones((3, 2))}
    model = rl.load(matlab73(tmp_path / "p.mat", empty), isolate=False)
    assert (model.n_states, model.n_inputs, model.n_outputs) == (0, 2, 3)
    bare = {"A": np.zeros((0, 0)), "B": np.zeros((0, 0)), "C": np.zeros((0, 0)), "D": np.ones((3, 2))}
    assert rl.load(matlab73(tmp_path / "q.mat", bare), isolate=False).B.shape == (0, 2)


def test_matlab_73_record(tmp_path):
    t = np.arange(5.0).reshape(-1, 1) * 0.1
    path = matlab73(tmp_path / "r.mat", {"t": t, "u": 2 * t, "q": 3 * t.T})
    record = rl.Record.read(path, inputs=["u"], outputs=["q"], isolate=False)
    np.testing.assert_array_equal(record["q"], 3 * t.ravel())
    with_rate = matlab73(tmp_path / "s.mat", {"Ts": 0.2, "run1": {"u": t, "q": t}})
    assert rl.Record.read(with_rate, group="run1", inputs=["u"], dt=0.2, isolate=False).n == 5


@pytest.mark.parametrize("compress", [False, True])
def test_matlab_5_in(compress, tmp_path):
    scipy.io.savemat(tmp_path / "p.mat", {**MATRICES, "dt": 0.5}, do_compression=compress)
    assert_model(rl.load(tmp_path / "p.mat"), 0.5)
    scipy.io.savemat(tmp_path / "q.mat", {"nominal": MATRICES, "perturbed": MATRICES}, do_compression=compress)
    for model in read(tmp_path / "q.mat", isolate=False).object:
        assert_model(model)


def test_matlab_5_types(tmp_path):
    """Integer, single, sparse and logical variables."""
    import scipy.sparse

    variables = {**MATRICES, "A": scipy.sparse.csc_array(A), "B": B.astype(np.int8), "C": C.astype(np.float32)}
    scipy.io.savemat(tmp_path / "p.mat", variables)
    assert_model(rl.load(tmp_path / "p.mat", isolate=False))
    scipy.io.savemat(tmp_path / "q.mat", {**MATRICES, "A": A + 0j * A + 1j})
    with pytest.raises(InputError, match="/A has dtype complex128, expected real numbers"):
        rl.load(tmp_path / "q.mat", isolate=False)


def test_matlab_5_out_is_what_scipy_reads(tmp_path):
    model = rl.StateSpaceModel(A, B, C, D, 0.1, [("u", "V"), ("Störung", "N m")], [("phi", "rad")])
    rl.save(tmp_path / "p.mat", model)
    content = scipy.io.loadmat(tmp_path / "p.mat")
    for name, value in MATRICES.items():
        np.testing.assert_array_equal(content[name], value)
    assert content["dt"].item() == 0.1
    assert [cell.item().item() for cell in content["InputName"]] == ["u", "Störung"]
    assert [cell.item().item() for cell in content["InputUnit"]] == ["V", "N m"]
    back = rl.load(tmp_path / "p.mat", isolate=False)
    assert (back.inputs, back.outputs, back.states) == (model.inputs, model.outputs, model.states)


@pytest.mark.parametrize("ext", ["h5", "mat"])
def test_python_control_in_and_out(ext, tmp_path):
    """The response of the stored system, by python-control itself."""
    system = control.ss(A, B, C, D, inputs=["u", "w"], outputs=["y"])
    rl.save(tmp_path / f"p.{ext}", system)
    back = rl.load(tmp_path / f"p.{ext}", isolate=False).to_control()
    assert (back.input_labels, back.output_labels) == (["u", "w"], ["y"])
    for omega in (0.0, 0.3, 10.0):
        np.testing.assert_allclose(back(1j * omega), system(1j * omega), rtol=1e-12)


def test_plain_h5py_reads_format_1_as_documented(tmp_path):
    """A reader in another language gets 2-D float64, text datasets of fixed length, checksums, old superblock."""
    rl.save(tmp_path / "p.h5", rl.StateSpaceModel(A, B, C, D, 0.1, [("u", "V"), ("Störung", "N m")], [("phi", "rad")]))
    with h5py.File(tmp_path / "p.h5") as file:
        assert file.attrs["format"] == "robustlab"  # text attributes come back as str
        assert (file.attrs["format_version"], file.attrs["kind"]) == ("1.0", "state-space")
        assert len(file.attrs["content_sha256"]) == 64
        assert file.attrs["dt"] == 0.1
        for name, value in MATRICES.items():
            assert (file[name].dtype, file[name].fletcher32) == (np.float64, True)
            np.testing.assert_array_equal(file[name][()], value)
        names = file["signals/input/name"]
        assert names.dtype.kind == "S"
        assert h5py.check_string_dtype(names.dtype).encoding == "utf-8"
        assert [item.decode() for item in names[()]] == ["u", "Störung"]
    assert (tmp_path / "p.h5").read_bytes()[8] == 0  # superblock version 0


def test_the_documented_hash_by_a_second_program(tmp_path):
    """docs/hdf5-format.md, followed literally and independently on a file read with h5py."""
    import hashlib

    rl.save(tmp_path / "p.h5", rl.StateSpaceModel(A, B, C, D, 0.1, [("u", "V"), ("Störung", "N m")], [("phi", "rad")]))

    def net(text):
        raw = text if isinstance(text, bytes) else text.encode()
        return str(len(raw)).encode() + b":" + raw

    def array(values):
        values = np.asarray(np.bytes_(values.encode()) if isinstance(values, str) else values)
        shape = ",".join(map(str, values.shape))
        if values.dtype.kind == "S":
            return f"text({shape})".encode() + b"".join(net(item) for item in values.ravel().tolist())
        return {"f": "f8", "i": "i8"}[values.dtype.kind].encode() + f"({shape})".encode() + values.tobytes()

    digest = hashlib.sha256()
    with h5py.File(tmp_path / "p.h5") as file:
        items = {"/": file}
        file.visititems(lambda name, item: items.__setitem__(f"/{name}", item))
        for path in sorted(items, key=str.encode):
            if path.startswith("/provenance"):
                continue
            item = items[path]
            digest.update((b"D" if isinstance(item, h5py.Dataset) else b"G") + net(path))
            if isinstance(item, h5py.Dataset):
                digest.update(array(item[()]))
            for name in sorted(item.attrs, key=str.encode):
                if name != "content_sha256":
                    digest.update(b"A" + net(name) + array(item.attrs[name]))
        assert digest.hexdigest() == file.attrs["content_sha256"]
