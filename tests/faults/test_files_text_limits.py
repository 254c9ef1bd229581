"""Text that hangs, nests or grows is parsed in a process of its own; MATLAB files count before they are inflated."""

from __future__ import annotations

import json
import re
import struct
import subprocess
import sys
import zlib

import pytest

import robustlab as rl
from robustlab.errors import InputError
from robustlab.files import MAX_DEPTH, parse_document, read_tree
from robustlab.recipe import load_recipe, read_result
from robustlab.storage import load_parametric

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


def told_and_taken(call, path):
    """What a fresh process says of a file, and the bytes that it and its children took.

    A child of this process, and by ``ru_maxrss`` even the fresh process, begin with the memory of all tests before.
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
        ("+".join(f"1/({k}+p0+p1)" for k in range(1, 80)), "factors of .* variables"),
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
    message, taken = told_and_taken("import robustlab; robustlab.load(sys.argv[1])", tmp_path / "p.mat")
    assert re.search(rf"p\.mat: {words}", message)
    assert taken < 1 << 31


def test_lengths_of_matlab_files(tmp_path):
    longer = bytearray(HEADER + zeros(4, "x"))
    longer[-36:-32] = struct.pack("<I", 4096)  # the data say that they go on beyond their matrix
    (tmp_path / "p.mat").write_bytes(longer)
    with pytest.raises(InputError, match="damaged"):
        rl.load(tmp_path / "p.mat")


# --- HDF5 ------------------------------------------------------------------------------------------------------------


def test_numbers_count_as_they_stand_in_memory(tmp_path):
    import h5py

    with h5py.File(tmp_path / "p.h5", "w") as file:
        file.create_dataset("A", (8000, 8000), "i1", chunks=(1000, 1000), compression=9)[...] = 1
    with pytest.raises(InputError, match=r"/A: declares 8000 x 8000 \(512 MB\), limit 256 MiB"):
        read_tree(tmp_path / "p.h5")
