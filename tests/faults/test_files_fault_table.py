"""Bad files, rows 1 to 17 of the fault table: one clear message, exit code 3, and nothing else."""

import json
import os
import re
import stat
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
import scipy.io

import robustlab as rl
from robustlab.cli import main_guard, run_command
from robustlab.errors import InputError
from robustlab.files import MAX_DEPTH, hdf5, parse_document, read_tree
from robustlab.recipe import load_recipe, read_result
from robustlab.storage import load_parametric

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


# --- builders: each makes a bad file at p.h5, or returns the path of another one ------------------------------------


def missing(path):
    plain(path.with_name("plant.h5"))
    return path.with_name("plnt.h5")


def npz_renamed(path):
    np.savez(path.with_name("p.npz"), **matrices())
    return path.with_name("p.npz").rename(path.with_name("p.dat"))


def other(name, write):
    """A file of another name."""

    def make(path):
        write(path.with_name(name))
        return path.with_name(name)

    return make


def text_as_h5(path):
    path.write_text("hello world\n")


def pickled(path):
    import pickle

    path.write_bytes(pickle.dumps(matrices()))


def truncated(path):
    saved(path)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def rotten_values(path):
    raw = bytearray(saved(path).read_bytes())
    needle = struct.pack("<d", float(rl.load(path, isolate=False).A[0, 0]))
    raw[raw.index(needle) + 2] ^= 1
    path.write_bytes(raw)


def changed(write, made=saved):
    """A good file that is changed afterwards."""

    def make(path):
        with h5py.File(made(path), "a") as file:
            write(file)

    return make


def without_a(write):
    """A plain file whose A is written by ``write(file)``."""
    return changed(write, lambda path: plain(path, A=None))


def renewed(file):
    file["A"][0, 0] = 5.0  # HDF5 renews its own checksum; only the content hash detects it


changed_afterwards = changed(renewed)


def hash_renamed(path):
    path.write_bytes(saved(path).read_bytes().replace(b"content_sha256", b"content_sha257"))


def soft_link(file):
    file["hidden"] = np.eye(3)
    file["A"] = h5py.SoftLink("/hidden")


def external_link(path):
    pair(path.with_name("other.h5"))
    with h5py.File(path, "w") as file:
        file["nominal"] = h5py.ExternalLink("other.h5", "/nominal")
        file.create_group("perturbed")


@without_a
def external_storage(file):
    file.create_dataset("A", (3, 3), "f8", external=[("/etc/passwd", 0, 72)])


def references(file):
    file.create_dataset("A", data=np.array([[file["B"].ref]], dtype=h5py.ref_dtype))


def virtual(file):
    layout = h5py.VirtualLayout((3, 3), "f8")
    layout[:] = h5py.VirtualSource("other.h5", "A", (3, 3))
    file.create_virtual_dataset("A", layout)


def loop_of_groups(file):
    file.create_group("g")["back"] = file["/"]


@without_a
def giant(file):
    file.create_dataset("A", (10**6, 10**6), "f8", chunks=(100, 100))


def giant_chunk(file):
    file.create_dataset("A", (3, 3), "f8", chunks=(20_000, 20_000), maxshape=(None, None), compression="gzip")


def bomb(file):
    file.create_dataset("A", (5000, 5000), "f8", chunks=(5000, 1))[0, 0] = 1.0  # one chunk of 5000 is stored


def unknown_filter(file):
    create = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    create.set_chunk((3, 3))
    create.set_filter(32015, h5py.h5z.FLAG_OPTIONAL, (3,))
    h5py.h5d.create(file.id, b"A", h5py.h5t.NATIVE_DOUBLE, h5py.h5s.create_simple((3, 3)), create)


def misspelt(path):
    pair(path, perturbed={"B": None}, names=("nomnal", "perturbed"))


def nan(path):
    a = np.eye(12)
    a[3, 5] = a[4, 4] = np.nan
    pair(path, {"A": a})


def mat5_object_array(path):
    cells = np.empty((3, 3), dtype=object)
    cells[...] = 1.0
    scipy.io.savemat(path, {**matrices(), "A": cells})


def mat5_cut(path):
    scipy.io.savemat(path, matrices())
    path.write_bytes(path.read_bytes()[:-100])


def mat_giant(path):
    """The header of a variable that declares 8 TB."""
    scipy.io.savemat(path, {"A": np.eye(3)})
    path.write_bytes(path.read_bytes().replace(struct.pack("<ii", 3, 3), struct.pack("<ii", 10**6, 10**6), 1))


def units_differ(path):
    first = rl.StateSpaceModel(*matrices(2, 1, 1).values())
    with h5py.File(path, "w") as file:
        for name, unit in (("nominal", "rad"), ("perturbed", "deg")):
            for key in "ABCD":
                file[f"{name}/{key}"] = getattr(first, key)
            file[f"{name}/signals/output/name"] = ["phi"]
            file[f"{name}/signals/output/unit"] = [unit]


CHECK = ("model", "check")
CASES = [
    ("1 missing", missing, r"plnt.h5: no such file \(looked in .*\)\nhint: did you mean plant.h5\?"),
    ("1 folder", Path.mkdir, r"p.h5: is a directory, expected a file"),
    ("1 pipe", os.mkfifo, r"p.h5: is not a regular file .*"),
    ("2 empty", Path.touch, r"p.h5: empty file \(0 bytes\), expected .*"),
    ("2 text", text_as_h5, r"p.h5: not an HDF5 file \(first bytes 68 65 6c 6c\)"),
    (
        "33 npz",
        other("p.npz", lambda path: np.savez(path, **matrices())),
        r"p.npz: .npz files are refused: [\s\S]*rl\.save\('[\s\S]*p\.h5', rl\.Record[\s\S]*",
    ),
    ("34 zip", npz_renamed, r"p.dat: a zip archive .* is refused: .*"),
    (
        "33 pickle",
        other("p.pkl", pickled),
        r"p.pkl: .pkl files are refused: such files can carry code[\s\S]*read_pickle[\s\S]*",
    ),
    ("3 truncated", truncated, r"p.h5: truncated: \d+ of \d+ bytes\nhint: copy .*"),
    (
        "3 signature only",
        lambda path: path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(12)),
        r"p.h5: damaged or truncated HDF5 file of 20 bytes .*\nhint: copy .*",
    ),
    ("4 bit rot", rotten_values, r"p.h5: /A: checksum mismatch\nhint: .*"),
    ("4 content hash", changed_afterwards, r"p.h5: /: checksum mismatch \(content_sha256\).*\nhint: .*--no-verify"),
    (
        "4 hash attribute",
        hash_renamed,
        r"p.h5: unexpected attribute 'content_sha257'\nhint: did you mean content_sha256\?",
    ),
    ("6 soft link", without_a(soft_link), r"p.h5: /A: soft link to '/hidden' is not allowed"),
    ("6 external link", external_link, r"p.h5: /nominal: external link to 'other.h5' '/nominal' is not allowed"),
    ("6 external storage", external_storage, r"p.h5: /A: external storage '/etc/passwd' is not allowed"),
    ("6 virtual", without_a(virtual), r"p.h5: /A: virtual dataset .* is not allowed"),
    ("6 references", without_a(references), r"p.h5: /A has dtype reference, expected real numbers"),
    ("6 loop", changed(loop_of_groups, plain), r"p.h5: /g/back: group is linked twice .*"),
    ("7 giant", giant, r"p.h5: /A: declares 1000000 x 1000000 \(8 TB\), limit 256 MiB"),
    ("7 chunk", without_a(giant_chunk), r"p.h5: /A: chunks of 3.2 GB in memory, limit 256 MiB"),
    ("7 bomb", without_a(bomb), r"p.h5: /A: declares 200 MB in 40000 stored bytes: made to grow when it is read"),
    (
        "7 unwritten",
        without_a(lambda file: file.create_dataset("A", (3, 3), "f8")),
        r"p.h5: /A: declares 3 x 3, but no values are stored",
    ),
    (
        "8 filter",
        without_a(unknown_filter),
        r"p.h5: /A: filter 32015.* is not known here; plugins are not loaded\nhint: h5repack .*",
    ),
    (
        "9 misspelt",
        misspelt,
        r"p.h5: missing /nominal\n.*p.h5: unexpected /nomnal \(did you mean /nominal\?\)\n.*p.h5: missing /perturbed/B",
    ),
    (
        "9 lower case",
        lambda path: plain(path, A=None, a=np.eye(3)),
        r"p.h5: missing /A\n.*p.h5: unexpected /a \(did you mean /A\?\)",
    ),
    (
        "9 kind",
        changed(lambda file: file.attrs.update(kind="statespace")),
        r"p.h5: attribute kind is 'statespace', expected one of .*\nhint: did you mean state-space\?",
    ),
    (
        "10 newer",
        changed(lambda file: file.attrs.update(format_version="2.0")),
        r"p.h5: written by schema 2.0, this robustlab reads <= 1.x; upgrade\nhint: .*",
    ),
    ("11 text", lambda path: plain(path, A="three"), r"p.h5: /A has dtype text, expected real numbers"),
    ("12 NaN", nan, r"p.h5: /nominal/A\[3,5\] is NaN \(2 of 144 entries\)"),
    ("34 cells", other("p.mat", mat5_object_array), r"p.mat: /A has dtype cell array, expected real numbers"),
    ("3 mat", other("p.mat", mat5_cut), r"p.mat: damaged MATLAB file .*"),
    ("34 mat giant", other("p.mat", mat_giant), r"p.mat: /A: declares 8 TB, limit 256 MiB"),
    ("17 units", units_differ, r"p.h5: output phi: nominal \[rad\], perturbed \[deg\], expected equal units"),
]

DTYPES = {
    "complex128": np.eye(3) + 1j,
    "bool": np.eye(3, dtype=bool),
    "float16": np.eye(3, dtype=np.float16),
    r"compound \(x, y\)": np.zeros((3, 3), dtype=[("x", "f8"), ("y", "f8")]),
    "opaque": np.zeros((3, 3), dtype="V8"),
}
TWICE = r"\nhint: [^\n]*a real one of twice the size[^\n]*"
SHAPES = [
    ({"A": np.ones((3, 4))}, r"p.h5: /A is \(3, 4\), expected \(3, 3\)"),
    ({"B": np.ones((4, 2))}, r"p.h5: /B is \(4, 2\), expected \(3, 2\)"),
    ({"C": np.ones((4, 2))}, r"p.h5: /C is \(4, 2\), expected \(4, 3\)"),
    ({"D": np.ones((5, 2))}, r"p.h5: /D is \(5, 2\), expected \(4, 2\)"),
    ({"B": np.ones(3)}, r"p.h5: /B is \(3,\), expected 2 dimensions: \(3, 1\) for a column, \(1, 3\) for a row"),
    ({"D": np.ones((4, 2, 1))}, r"p.h5: /D is \(4, 2, 1\), expected 2 dimensions"),
    ({"dt": -1.0}, r"p.h5: /dt is -1, expected 0 \(continuous\) or a positive sample time in s"),
    ({"dt": np.array([0.1, 0.2])}, r"p.h5: /dt is not one real number, expected .*"),
    (
        {"A": [[1, np.inf, 0], [0, 1, 0], [0, 0, 1]], "B": None, "C": np.ones(3)},
        (
            r"p.h5: missing /B\np.h5: /A\[0,1\] is infinite \(1 of 9 entries\)\n"
            r"p.h5: /C is \(3,\), expected 2 dimensions: \(3, 1\) for a column, \(1, 3\) for a row"
        ),
    ),
    *(
        ({"A": value}, f"p.h5: /A has dtype {name}, expected real numbers{TWICE if name == 'complex128' else ''}")
        for name, value in DTYPES.items()
    ),
]
CASES += [("13", lambda path, changes=changes: plain(path, **changes), pattern) for changes, pattern in SHAPES]
CASES.append((
    "13 perturbed",
    lambda path: pair(path, perturbed={"A": np.ones((12, 10)), "C": np.ones((11, 12))}),
    (r"p.h5: /perturbed/A is \(12, 10\), expected \(12, 12\) to match /nominal/A\n"
    r"p.h5: /perturbed/C is \(11, 12\), expected \(12, 12\) to match /nominal/C"),
))  # fmt: skip


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


def made(make, folder):
    """The path of the bad file."""
    found = make(folder / "p.h5")
    return found if isinstance(found, Path) else folder / "p.h5"


@pytest.mark.parametrize(("row", "make", "pattern"), CASES, ids=[case[0] for case in CASES])
def test_bad_file(row, make, pattern, tmp_path, capfd, request):
    if row.split()[0] in ("9", "10", "11", "12", "13", "17"):
        request.getfixturevalue("in_process")
    code, err = run(capfd, made(make, tmp_path))
    assert_refused(code, err, pattern, tmp_path)


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
    path = made(changed_afterwards, tmp_path)
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


@pytest.mark.parametrize(
    "make", [truncated, external_storage, giant, misspelt, text_as_h5], ids=lambda make: make.__name__
)
def test_the_same_through_the_real_command(make, tmp_path):
    path = made(make, tmp_path)
    command = [sys.executable, "-m", "robustlab.cli.main", "model", "convert", path.name, "out.h5"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith(f"error: {path.name}: ")
    assert len(done.stderr.splitlines()) <= 4
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "out.h5").exists()
    assert not list(tmp_path.glob(".robustlab-*"))


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


# --- text that hangs, nests or grows ----------------------------------------------------------------------------------


HOSTILE = {
    "a number of 5000 digits": "9" * 5000,
    "200 000 brackets": "[" * 200_000,
    "200 000 brackets, closed": "[" * 200_000 + "]" * 200_000,
    "a hundred levels": "[" * (MAX_DEPTH + 36) + "]" * (MAX_DEPTH + 36),
}


@pytest.mark.parametrize("what", HOSTILE)
@pytest.mark.parametrize("reader", ["result", "recipe", "expressions"])
def test_numbers_and_brackets_without_end(reader, what, tmp_path):
    json_text, toml_text = f'{{"schema": {HOSTILE[what]}}}', f"A = {HOSTILE[what]}\n"
    name = {"result": "result.json"}.get(reader, "x.toml")
    (tmp_path / name).write_text(json_text if name.endswith("json") else toml_text)
    read = {
        "result": lambda: read_result(tmp_path),
        "recipe": lambda: load_recipe(tmp_path / name),
        "expressions": lambda: load_parametric(tmp_path / name),
    }[reader]
    with pytest.raises(InputError, match=r"not (readable|valid)") as caught:
        read()
    assert len(caught.value.line) < 300
    assert not caught.value.more


MEASURED = """
import resource, sys
from pathlib import Path
from robustlab.errors import InputError
try:
    {call}
except InputError as error:
    print(error.line)
own = int(Path("/proc/self/status").read_text().split("VmHWM:")[1].split()[0])
print(max(own, resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss) * 1024)
"""


def output_and_memory(call, path):
    """Return the output of a fresh process about a file, and the bytes that it and its children took.

    A child of this process, and by ``ru_maxrss`` even the fresh process, starts with the memory of all tests before.
    """
    done = subprocess.run(
        [sys.executable, "-c", MEASURED.format(call=call), str(path)], capture_output=True, text=True, check=True
    )
    *message, taken = done.stdout.splitlines()
    return " ".join(message), int(taken)


def test_faults_of_documents_are_reported():
    with pytest.raises(InputError, match="f: 40 MB of JSON, expected at most 32 MiB"):
        parse_document("json", b" " * 40_000_000, "f")
    for raw, words in [
        (b'{"a": "\\ud800"}', "surrogates not allowed"),
        (b"\xff\xfe", "byte 0 is not UTF-8"),
        (b'{"a": NaN}', "NaN is among the numbers"),
        (b'{"a": 1, "a": 2}', "key 'a' is written twice"),
    ]:
        with pytest.raises(InputError, match=words):
            parse_document("json", raw, "f")
    with pytest.raises(InputError, match="a whole number beyond 64 bits"):
        parse_document("toml", b"a = 0x" + b"f" * 40_000, "f")


def test_a_recipe_of_a_hundred_thousand_faults_is_refused_at_once(tmp_path):
    text = 'schema = "robustlab.recipe/1"\nname = "x"\n' + "".join(f"k{i} = 1\n" for i in range(70_000))
    (tmp_path / "r.toml").write_text(text)
    with pytest.raises(InputError, match="faults") as caught:
        load_recipe(tmp_path / "r.toml")
    assert len(caught.value.more) == 51


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ("+".join(f"1/({k}+p0+p1)" for k in range(1, 80)), "products of terms"),
        ("*".join(["(p0+p1+p2+p3)**4"] * 60), "terms|products of terms"),
    ],
)
def test_expressions_beyond_any_search_are_refused(entry, words, tmp_path):
    rows = ",".join("[" + ",".join(f"'{entry} + {i + j}*p0'" for j in range(6)) + "]" for i in range(6))
    rest = "B=[" + ",".join(["[1]"] * 6) + "]\nC=[[1,1,1,1,1,1]]\nD=[[0]]\n[parameters]\n"
    (tmp_path / "e.toml").write_text(f"A=[{rows}]\n{rest}" + "".join(f"p{i} = [1.0, 0.1]\n" for i in range(4)))
    with pytest.raises(InputError, match=words):
        load_parametric(tmp_path / "e.toml")


def test_a_hostile_result_is_bad_input(tmp_path):
    result = {
        "schema": "robustlab.result/1",
        "command": "run",
        "steps": [{"name": "a"}],
        "requirements": [],
        "files": 3,
    }
    (tmp_path / "result.json").write_text(json.dumps(result))
    with pytest.raises(InputError, match=r"result\.json: steps\.0\.\w+ is missing or has another form"):
        read_result(tmp_path)


# --- MATLAB 5 --------------------------------------------------------------------------------------------------------

HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"


def element(kind, data):
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(kind, sizes, name, *content):
    flags, dims = element(6, struct.pack("<II", kind, 0)), element(5, struct.pack(f"<{len(sizes)}i", *sizes))
    body = flags + dims + element(1, name.encode()) + b"".join(content)
    return struct.pack("<II", 14, len(body)) + body


def zeros(count, name=""):
    return matrix(6, (count, 1), name, element(9, bytes(8 * count)))


def compressed(variable):
    packed = zlib.compress(variable, 1)
    return struct.pack("<II", 15, len(packed)) + packed


BOMBS = {
    "many variables": (lambda: compressed(zeros(5_000_000, "v")) * 15, r"/v: with this variable \d+ MB in all"),
    "a cell of many": (
        lambda: compressed(matrix(1, (400, 1), "c", *[zeros(1_000_000)] * 400)),
        "needs more memory than the reader may use",
    ),
    "bytes that become float64": (
        lambda: compressed(matrix(6, (60_000_000, 1), "x", element(2, bytes(60_000_000)))),
        "/x: declares 480 MB",
    ),
    "more data than its sizes say": (
        lambda: compressed(matrix(6, (2, 2), "l", element(9, bytes(300_000_000)))),
        "damaged MATLAB file",
    ),
    "structs without fields": (
        lambda: matrix(2, (1_000_000, 1), "s", element(5, struct.pack("<i", 8)), element(1, b"")),
        "/s: declares 400 MB",
    ),
}  # fmt: skip


@pytest.mark.parametrize(
    "what", [pytest.param(name, marks=pytest.mark.slow) if name == "a cell of many" else name for name in BOMBS]
)
def test_matlab_files_that_grow_are_refused(what, tmp_path):
    make, words = BOMBS[what]
    (tmp_path / "p.mat").write_bytes(HEADER + make())
    message, taken = output_and_memory("import robustlab; robustlab.load(sys.argv[1])", tmp_path / "p.mat")
    assert re.search(rf"p\.mat: {words}", message)
    assert taken < 1 << 31


def test_lengths_of_matlab_files(tmp_path):
    longer = bytearray(HEADER + zeros(4, "x"))
    longer[-36:-32] = struct.pack("<I", 4096)  # the data size extends beyond its matrix
    (tmp_path / "p.mat").write_bytes(longer)
    with pytest.raises(InputError, match="damaged"):
        rl.load(tmp_path / "p.mat")


# --- HDF5 ------------------------------------------------------------------------------------------------------------


def test_numbers_count_as_they_stand_in_memory(tmp_path):
    with h5py.File(tmp_path / "p.h5", "w") as file:
        file.create_dataset("A", (8000, 8000), "i1", chunks=(1000, 1000), compression=9)[...] = 1
    with pytest.raises(InputError, match=r"/A: declares 8000 x 8000 \(512 MB\), limit 256 MiB"):
        read_tree(tmp_path / "p.h5")
