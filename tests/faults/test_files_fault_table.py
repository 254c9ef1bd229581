"""Bad files, rows 1 to 17 of the fault table: one clear message, exit code 3, and nothing else."""

import os
import re
import stat
import struct
import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

import robustlab as rl
from robustlab.cli import main_guard, run_command
from robustlab.files import hdf5

RNG = np.random.default_rng(1)


def matrices(n=3, m=2, p=4):
    return {
        "A": -np.eye(n) + 0.1 * RNG.normal(size=(n, n)),
        "B": RNG.normal(size=(n, m)),
        "C": RNG.normal(size=(p, n)),
        "D": RNG.normal(size=(p, m)),
    }


def plain(path, **changes):
    """A plain file with A B C D, some of them replaced (None leaves one out)."""
    with h5py.File(path, "w") as file:
        for name, value in {**matrices(), **changes}.items():
            if value is not None:
                file[name] = value
    return path


def pair(path, nominal=None, perturbed=None, names=("nominal", "perturbed")):
    with h5py.File(path, "w") as file:
        for group, changes in zip(names, (nominal, perturbed), strict=True):
            for name, value in {**matrices(12, 6, 12), **(changes or {})}.items():
                if value is not None:
                    file[f"{group}/{name}"] = value
    return path


def model():
    return rl.StateSpaceModel(*matrices().values(), inputs=[("u1", "V"), ("u2", "V")])


def saved(path):
    rl.save(path, model())
    return path


def change_a_value(file, _folder):
    file["A"][0, 0] = 5.0  # HDF5 renews its own checksum; the content hash tells


# --- builders: each makes a bad file in an empty folder and returns its path ------------------------------------------


def missing(folder):
    plain(folder / "plant.h5")
    return folder / "plnt.h5"


def a_folder(folder):
    (folder / "p.h5").mkdir()
    return folder / "p.h5"


def a_pipe(folder):
    os.mkfifo(folder / "p.h5")
    return folder / "p.h5"


def empty(folder):
    (folder / "p.h5").touch()
    return folder / "p.h5"


def text_as_h5(folder):
    (folder / "p.h5").write_text("hello world\n")
    return folder / "p.h5"


def npz(folder):
    np.savez(folder / "p.npz", **matrices())
    return folder / "p.npz"


def npz_renamed(folder):
    np.savez(folder / "p.npz", **matrices())
    return (folder / "p.npz").rename(folder / "p.dat")


def pickled(folder):
    import pickle

    (folder / "p.pkl").write_bytes(pickle.dumps(matrices()))
    return folder / "p.pkl"


def truncated(folder):
    path = saved(folder / "p.h5")
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    return path


def only_a_signature(folder):
    (folder / "p.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(12))
    return folder / "p.h5"


def rotten_values(folder):
    path = saved(folder / "p.h5")
    raw = bytearray(path.read_bytes())
    needle = struct.pack("<d", float(rl.load(path, isolate=False).A[0, 0]))
    raw[raw.index(needle) + 2] ^= 1
    path.write_bytes(raw)
    return path


def hash_renamed(folder):
    path = saved(folder / "p.h5")
    path.write_bytes(path.read_bytes().replace(b"content_sha256", b"content_sha257"))
    return path


def edited(change, made=lambda path: plain(path, A=None)):
    """Return the builder of a file that is changed after it was made."""

    def build(folder):
        path = made(folder / "p.h5")
        with h5py.File(path, "a") as file:
            change(file, folder)
        return path

    return build


def soft_link(file, _folder):
    file["hidden"] = np.eye(3)
    file["A"] = h5py.SoftLink("/hidden")


def external_link(file, folder):
    plain(folder / "other.h5")
    file["A"] = h5py.ExternalLink("other.h5", "/A")


def external_link_mid_path(file, folder):
    pair(folder / "other.h5")
    file["nominal"] = h5py.ExternalLink("other.h5", "/nominal")
    file.create_group("perturbed")


def external_storage(file, _folder):
    file.create_dataset("A", (3, 3), "f8", external=[("/etc/passwd", 0, 72)])


def virtual(file, folder):
    plain(folder / "other.h5")
    layout = h5py.VirtualLayout((3, 3), "f8")
    layout[:] = h5py.VirtualSource(str(folder / "other.h5"), "A", (3, 3))
    file.create_virtual_dataset("A", layout)


def references(file, _folder):
    file.create_dataset("A", data=np.array([[file["B"].ref]], dtype=h5py.ref_dtype))


def loop_of_groups(file, _folder):
    file["A"] = np.eye(3)
    file.create_group("g")["back"] = file["/"]


def giant(file, _folder):
    file.create_dataset("A", (10**6, 10**6), "f8", chunks=(100, 100))


def giant_chunk(file, _folder):
    file.create_dataset("A", (3, 3), "f8", chunks=(20_000, 20_000), maxshape=(None, None), compression="gzip")


def bomb(file, _folder):
    a = file.create_dataset("A", (5000, 5000), "f8", chunks=(5000, 1))
    a[0, 0] = 1.0  # one chunk of 5000 is stored, the file claims 200 MB


def never_written(file, _folder):
    file.create_dataset("A", (3, 3), "f8")


def unknown_filter(file, _folder):
    create = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    create.set_chunk((3, 3))
    create.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))
    h5py.h5d.create(file.id, b"A", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((3, 3)), create)


def misspelt(folder):
    return pair(folder / "p.h5", perturbed={"B": None}, names=("nomnal", "perturbed"))


def wrong_kind(file, _folder):
    file.attrs["kind"] = "statespace"


def newer(file, _folder):
    file.attrs["format_version"] = "2.0"


def nan(folder):
    a = np.eye(12)
    a[3, 5] = a[4, 4] = np.nan
    return pair(folder / "p.h5", {"A": a})


def mat5_object_array(folder):
    cells = np.empty((3, 3), dtype=object)
    cells[...] = 1.0
    scipy.io.savemat(folder / "p.mat", {**matrices(), "A": cells})
    return folder / "p.mat"


def mat5_cut(folder):
    scipy.io.savemat(folder / "p.mat", matrices())
    raw = (folder / "p.mat").read_bytes()
    (folder / "p.mat").write_bytes(raw[: len(raw) - 100])
    return folder / "p.mat"


def mat_giant(folder):
    """The header of a variable that declares 8 TB."""
    scipy.io.savemat(folder / "p.mat", {"A": np.eye(3)})
    raw = bytearray((folder / "p.mat").read_bytes())
    at = raw.index(struct.pack("<ii", 3, 3))
    raw[at : at + 8] = struct.pack("<ii", 10**6, 10**6)
    (folder / "p.mat").write_bytes(raw)
    return folder / "p.mat"


def units_differ(folder):
    first = rl.StateSpaceModel(*matrices(2, 1, 1).values(), outputs=[("phi", "rad")])
    for name, unit in (("nominal", "rad"), ("perturbed", "deg")):
        with h5py.File(folder / "p.h5", "a") as file:
            for key in "ABCD":
                file[f"{name}/{key}"] = getattr(first, key)
            file[f"{name}/signals/output/name"] = ["phi"]
            file[f"{name}/signals/output/unit"] = [unit]
    return folder / "p.h5"


CHECK = ("model", "check")
CASES = [
    ("1 missing", missing, r"plnt.h5: no such file \(looked in .*\)\nhint: did you mean plant.h5\?"),
    ("1 folder", a_folder, r"p.h5: is a directory, expected a file"),
    ("1 pipe", a_pipe, r"p.h5: is not a regular file .*"),
    ("2 empty", empty, r"p.h5: empty file \(0 bytes\), expected .*"),
    ("2 text", text_as_h5, r"p.h5: not an HDF5 file \(first bytes 68 65 6c 6c\)"),
    ("33 npz", npz, r"p.npz: .npz files are refused: [\s\S]*rl\.save\('[\s\S]*p\.h5', rl\.Record[\s\S]*"),
    ("34 zip", npz_renamed, r"p.dat: a zip archive .* is refused: .*"),
    ("33 pickle", pickled, r"p.pkl: .pkl files are refused: such files can carry code[\s\S]*read_pickle[\s\S]*"),
    ("3 truncated", truncated, r"p.h5: truncated: \d+ of \d+ bytes\nhint: copy .*"),
    ("3 signature only", only_a_signature, r"p.h5: damaged or truncated HDF5 file of 20 bytes .*\nhint: copy .*"),
    ("4 bit rot", rotten_values, r"p.h5: /A: checksum mismatch\nhint: .*"),
    (
        "4 content hash",
        edited(change_a_value, saved),
        r"p.h5: /: checksum mismatch \(content_sha256\).*\nhint: .*--no-verify",
    ),
    (
        "4 hash attribute",
        hash_renamed,
        r"p.h5: unexpected attribute 'content_sha257'\nhint: did you mean content_sha256\?",
    ),
    ("6 soft link", edited(soft_link), r"p.h5: /A: soft link to '/hidden' is not allowed"),
    ("6 external link", edited(external_link), r"p.h5: /A: external link to 'other.h5' '/A' is not allowed"),
    (
        "6 mid-path",
        edited(external_link_mid_path),
        r"p.h5: /nominal: external link to 'other.h5' '/nominal' is not allowed",
    ),
    ("6 external storage", edited(external_storage), r"p.h5: /A: external storage '/etc/passwd' is not allowed"),
    ("6 virtual", edited(virtual), r"p.h5: /A: virtual dataset .* is not allowed"),
    ("6 references", edited(references), r"p.h5: /A has dtype reference, expected real numbers"),
    ("6 loop", edited(loop_of_groups), r"p.h5: /g/back: group is linked twice .*"),
    ("7 giant", edited(giant), r"p.h5: /A: declares 1000000 x 1000000 \(8 TB\), limit 256 MiB"),
    ("7 chunk", edited(giant_chunk), r"p.h5: /A: chunks of 3.2 GB in memory, limit 256 MiB"),
    ("7 bomb", edited(bomb), r"p.h5: /A: declares 200 MB in 40000 stored bytes: made to grow when it is read"),
    ("7 unwritten", edited(never_written), r"p.h5: /A: declares 3 x 3, but no values are stored"),
    (
        "8 filter",
        edited(unknown_filter),
        r"p.h5: /A: filter 32015.* is not known here; plugins are not loaded\nhint: h5repack .*",
    ),
    (
        "9 misspelt",
        misspelt,
        r"p.h5: missing /nominal\n.*p.h5: unexpected /nomnal \(did you mean /nominal\?\)\n.*p.h5: missing /perturbed/B",
    ),
    (
        "9 lower case",
        edited(lambda file, _: file.update(a=np.eye(3))),
        r"p.h5: missing /A\n.*p.h5: unexpected /a \(did you mean /A\?\)",
    ),
    (
        "9 kind",
        edited(wrong_kind, saved),
        r"p.h5: attribute kind is 'statespace', expected one of .*\nhint: did you mean state-space\?",
    ),
    ("10 newer", edited(newer, saved), r"p.h5: written by schema 2.0, this robustlab reads <= 1.x; upgrade\nhint: .*"),
    ("11 text", edited(lambda file, _: file.update(A="three")), r"p.h5: /A has dtype text, expected real numbers"),
    ("12 NaN", nan, r"p.h5: /nominal/A\[3,5\] is NaN \(2 of 144 entries\)"),
    ("34 cells", mat5_object_array, r"p.mat: /A has dtype cell array, expected real numbers"),
    ("3 mat", mat5_cut, r"p.mat: damaged MATLAB file .*"),
    ("34 mat giant", mat_giant, r"p.mat: /A: declares 8 TB, limit 256 MiB"),
    ("17 units", units_differ, r"p.h5: output phi: nominal \[rad\], perturbed \[deg\], expected equal units"),
]

DTYPES = {
    "complex128": np.eye(3) + 1j,
    "bool": np.eye(3, dtype=bool),
    "float16": np.eye(3, dtype=np.float16),
    r"compound \(x, y\)": np.zeros((3, 3), dtype=[("x", "f8"), ("y", "f8")]),
    "opaque": np.zeros((3, 3), dtype="V8"),
}
SHAPES = [
    ({"A": np.ones((3, 4))}, r"/A is \(3, 4\), expected \(3, 3\)"),
    ({"B": np.ones((4, 2))}, r"/B is \(4, 2\), expected \(3, 2\)"),
    ({"C": np.ones((4, 2))}, r"/C is \(4, 2\), expected \(4, 3\)"),
    ({"D": np.ones((5, 2))}, r"/D is \(5, 2\), expected \(4, 2\)"),
    ({"B": np.ones(3)}, r"/B is \(3,\), expected 2 dimensions: \(3, 1\) for a column, \(1, 3\) for a row"),
    ({"D": np.ones((4, 2, 1))}, r"/D is \(4, 2, 1\), expected 2 dimensions"),
    ({"dt": -1.0}, r"/dt is -1, expected 0 \(continuous\) or a positive sample time in s"),
    ({"dt": np.array([0.1, 0.2])}, r"/dt is not one real number, expected .*"),
]


@pytest.fixture
def in_process(monkeypatch):
    """Read without the child process: it costs 0.3 s, and what the file's content means is judged outside it."""
    isolated = hdf5.read_tree
    monkeypatch.setattr("robustlab.storage.interchange.read_tree", lambda *args: isolated(*args[:3], isolate=False))


def run(capfd, path, command=CHECK, *options):
    """Exit code and stderr of a command on a file; nothing may come on stdout."""
    code = main_guard(lambda: run_command([*command, str(path), *options]))
    out, err = capfd.readouterr()
    assert out == ""
    return code, err


def assert_refused(code, err, pattern, folder):
    assert code == 3, err
    assert "Traceback" not in err
    assert "HDF5-DIAG" not in err
    text = err.replace(f"{folder}/", "").rstrip("\n")
    assert re.fullmatch(f"error: {pattern}", text), text


@pytest.mark.parametrize(("row", "make", "pattern"), CASES, ids=[case[0] for case in CASES])
def test_bad_file(row, make, pattern, tmp_path, capfd, request):
    if row.split()[0] in ("9", "10", "11", "12", "17"):
        request.getfixturevalue("in_process")
    code, err = run(capfd, make(tmp_path))
    assert_refused(code, err, pattern, tmp_path)


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize("name", DTYPES)
def test_row_11_wrong_type_is_named(name, tmp_path, capfd):
    code, err = run(capfd, plain(tmp_path / "p.h5", A=DTYPES[name]))
    way_round = r"\nhint: [^\n]*a real one of twice the size[^\n]*" if name == "complex128" else ""
    assert_refused(code, err, rf"p.h5: /A has dtype {name}, expected real numbers{way_round}", tmp_path)


@pytest.mark.usefixtures("in_process")
@pytest.mark.parametrize(("changes", "pattern"), SHAPES)
def test_row_13_wrong_shape_is_named(changes, pattern, tmp_path, capfd):
    code, err = run(capfd, plain(tmp_path / "p.h5", **changes))
    assert_refused(code, err, f"p.h5: {pattern}", tmp_path)


@pytest.mark.usefixtures("in_process")
def test_row_13_perturbed_is_held_against_nominal(tmp_path, capfd):
    path = pair(tmp_path / "p.h5", perturbed={"A": np.ones((12, 10)), "C": np.ones((11, 12))})
    code, err = run(capfd, path)
    lines = (
        r"p.h5: /perturbed/A is \(12, 10\), expected \(12, 12\) to match /nominal/A\n"
        r"p.h5: /perturbed/C is \(11, 12\), expected \(12, 12\) to match /nominal/C"
    )
    assert_refused(code, err, lines, tmp_path)


@pytest.mark.usefixtures("in_process")
def test_row_16_a_transposed_file_is_recognised_and_read_on_request(tmp_path, capfd):
    content = matrices(12, 6, 12)
    path = plain(tmp_path / "p.h5", **{name: value.T for name, value in content.items()})
    code, err = run(capfd, path)
    pattern = (
        r"p.h5: /B is \(6, 12\), expected \(12, 6\)\np.h5: /D is \(6, 12\), expected \(12, 6\)\n"
        r"hint: file looks column-major: use --transpose.*"
    )
    assert_refused(code, err, pattern, tmp_path)
    turned = rl.load(path, transpose=True)
    for name in "ABCD":
        np.testing.assert_array_equal(getattr(turned, name), content[name])


def test_row_4_no_verify_loads_with_a_warning(tmp_path, capfd):
    path = edited(change_a_value, saved)(tmp_path)
    assert main_guard(lambda: run_command(["model", "check", str(path), "--no-verify"])) == 0
    assert "does not match" in capfd.readouterr().err
    with pytest.warns(UserWarning, match="does not match"):
        assert rl.load(path, no_verify=True).A[0, 0] == 5.0


@pytest.mark.skipif(os.name == "nt" or os.geteuid() == 0, reason="root reads everything")
def test_row_1_no_permission(tmp_path, capfd):
    path = plain(tmp_path / "p.h5")
    path.chmod(0)
    code, err = run(capfd, path)
    path.chmod(stat.S_IRUSR | stat.S_IWUSR)
    assert_refused(code, err, r"p.h5: no permission to read it\nhint: chmod.*", tmp_path)


@pytest.mark.parametrize("make", [truncated, edited(external_storage), edited(giant), misspelt, text_as_h5])
def test_the_same_through_the_real_command(make, tmp_path):
    path = make(tmp_path)
    command = [sys.executable, "-m", "robustlab.cli.main", "model", "convert", path.name, "out.h5"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith(f"error: {path.name}: ")
    assert len(done.stderr.splitlines()) <= 4
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out.h5").exists()
    assert not list(tmp_path.glob(".robustlab-*"))


@pytest.mark.usefixtures("in_process")
def test_every_bad_matrix_of_a_file_is_listed(tmp_path, capfd):
    bad = np.eye(3)
    bad[0, 1] = np.inf
    code, err = run(capfd, plain(tmp_path / "p.h5", A=bad, B=None, C=np.ones(3)))
    pattern = (
        r"p.h5: missing /B\np.h5: /A\[0,1\] is infinite \(1 of 9 entries\)\n"
        r"p.h5: /C is \(3,\), expected 2 dimensions: \(3, 1\) for a column, \(1, 3\) for a row"
    )
    assert_refused(code, err, pattern, tmp_path)


def test_a_measured_file_is_no_model_and_names_its_groups(tmp_path, capfd):
    with h5py.File(tmp_path / "p.h5", "w") as file:
        file["train/u"] = np.ones(5)
        file["train/q"] = np.ones(5)
    code, err = run(capfd, tmp_path / "p.h5")
    assert code == 3
    assert "groups here: train" in err
    code, err = run(capfd, tmp_path / "p.h5", ("data", "check"))
    assert code == 3
    assert Path(tmp_path / "p.h5").name in err
    assert "--group train" in err
