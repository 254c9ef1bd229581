"""Spoiled files for every reader: each mutant must be read or refused in one clear line, quickly and in little memory.

    python benchmarks/fuzz.py 500            # mutants of each kind of file; the figures go to stdout

Mutants are read in processes forked from one that has loaded everything, under the limits of the reader process and
without a second isolation; what crashes or runs in circles there is read again through the public reader, which must
name it ("contained"), and so is every hundredth, for the same answer.
Counted as faults: any exception but a `RobustlabError` ("traceback"), more than 5 s of processor time ("hang"), more
than 1 GB on top of what the process had ("memory"), numbers that differ although the file's hash is called verified
("silent"), an error of more than one line of 4000 characters ("unclear").
"""

from __future__ import annotations

import contextlib
import faulthandler
import io
import itertools
import json
import os
import random
import re
import resource
import select
import shutil
import signal
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import scipy.io
import scipy.sparse

import robustlab as rl
from robustlab.dynamics import Descriptor, LinearPlant, Parameter
from robustlab.errors import RobustlabError
from robustlab.files.tree import Tree, content_sha256
from robustlab.recipe.load import find_files, load_recipe
from robustlab.recipe.run import read_result, write_report
from robustlab.result import Result
from robustlab.storage import interchange
from robustlab.storage.controller_export import export_controller
from robustlab.storage.expression_files import load_parametric

ROOT = Path(__file__).parents[1]
FAULTS = ("traceback", "hang", "memory", "silent", "unclear")
SECONDS, WALL, MEMORY, BATCH = 5, 300, 1 << 30, 25
ADDRESS_SPACE = 4096 << 20  # as robustlab.files.reader_process
Edit = Callable[[random.Random, bytes], bytes]


@dataclass(frozen=True)
class Reader:
    """One kind of file: good ones, how they are read, and edits that know their structure.

    ``read(path, isolate)`` returns what was read and whether its hash is called verified.
    """

    name: str
    seeds: tuple[tuple[str, bytes], ...]
    read: Callable[[Path, bool], tuple[Any, bool]]
    edits: tuple[Edit, ...]
    hashed: bool = False


@dataclass
class Found:
    """Outcomes of the mutants of one reader; ``faults`` holds (outcome, what, the mutant)."""

    counts: Counter[str] = field(default_factory=Counter)
    faults: list[tuple[str, str, bytes]] = field(default_factory=list)
    largest: int = 0
    slowest: float = 0.0


# --- edits of bytes and of text --------------------------------------------------------------------------------------

NUMBERS = [0, 1, 2, 0x7F, 0x80, 0xFF, 0x7FFF, 0xFFFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 62, (1 << 64) - 1]


def flip(rng: random.Random, raw: bytes) -> bytes:
    """One to eight bits, or one byte."""
    out = bytearray(raw)
    for _ in range(rng.choice((1, 1, 2, 8))):
        out[rng.randrange(len(out))] ^= rng.choice((1 << rng.randrange(8), rng.randrange(1, 256)))
    return bytes(out)


def cut(rng: random.Random, raw: bytes) -> bytes:
    """The end, or a piece out of the middle, is missing."""
    i, j = sorted(rng.randrange(len(raw)) for _ in range(2))
    return raw[:i] if rng.random() < 0.5 else raw[:i] + raw[j:]


def insert(rng: random.Random, raw: bytes) -> bytes:
    """Bytes more than there were: noise, a repeated piece, a thousand of one kind."""
    i, j = sorted(rng.randrange(len(raw)) for _ in range(2))
    piece = rng.choice(
        (rng.randbytes(rng.randrange(1, 64)), raw[i : min(j, i + 4096)], bytes([rng.randrange(256)]) * 1000)
    )
    return raw[:i] + piece + raw[i:]


def number(rng: random.Random, raw: bytes) -> bytes:
    """A whole number of 1, 2, 4 or 8 bytes is another one: a size, an offset, a type."""
    size = rng.choice((1, 2, 4, 8))
    i = rng.randrange(max(len(raw) - size, 1)) // size * size
    value = (rng.choice(NUMBERS) + rng.choice((-1, 0, 0, 1))) % (1 << 8 * size)
    return raw[:i] + value.to_bytes(size, rng.choice(("little", "big"))) + raw[i + size :]


BYTES: tuple[Edit, ...] = (flip, flip, cut, insert, number, number)

WORDS = [
    "", "0", "-1", "1e400", "-1e-400", "nan", "inf", "1_0", "0x" + "f" * 5000, "9" * 5000, "1" * 25, "true", "null",
    "[" * 200_000, "{" * 100_000, '{"a":' * 3000, "(" * 5000, " " * 60_000, "\t" * 60_000, "a" * 300_000, "-" * 9000,
    '"', "'", '"""', "\\", "\\ud800", "\x00", "\x1b[31m", "\u202e", "é" * 3000, "\ufeff", "=", "#", ",", ";",
    "\n" * 5000, "1979-05-27T07:32:00Z", "25:61:61", "a." * 4000, "[[a]]\n", "../../../etc/passwd", "x\u0000y",
    "k**30", "1/0", "x/(x-x)",
]  # fmt: skip
TOKEN = re.compile(r'"[^"\n]*"|[A-Za-z_][\w.-]*|[-+]?[\d.]+(?:[eE][-+]?\d+)?|[^\w\s]')


def word(rng: random.Random, raw: bytes) -> bytes:
    """A word, a number or a sign of the text is replaced, or one is added."""
    text = raw.decode("utf-8", "replace")
    places = [m.span() for m in TOKEN.finditer(text)] or [(0, len(text))]
    i, j = rng.choice(places)
    other = rng.choice(places)
    new = rng.choice((*WORDS, *WORDS, text[slice(*other)]))
    if rng.random() < 0.3:
        new = f'"{new}"'
    return (text[: i if rng.random() < 0.8 else j] + new + text[j:]).encode("utf-8", "surrogatepass")


def line(rng: random.Random, raw: bytes) -> bytes:
    """Lines are missing, doubled, swapped, a thousand times there."""
    lines = raw.split(b"\n")
    i, j = (rng.randrange(len(lines)) for _ in range(2))
    match rng.randrange(4):
        case 0:
            del lines[i]
        case 1:
            lines[i:i] = [lines[j]]
        case 2:
            lines[i], lines[j] = lines[j], lines[i]
        case _:
            lines[i:i] = [lines[j]] * 2000
    return b"\n".join(lines)


def encoding(rng: random.Random, raw: bytes) -> bytes:
    """Another encoding, or another end of lines."""
    text = raw.decode("utf-8", "replace")
    name = rng.choice(("utf-16", "utf-8-sig", "utf-32", "latin-1"))
    return rng.choice((text.encode(name, "replace"), raw.replace(b"\n", b"\r"), raw.replace(b",", b";"), raw.upper()))


TEXT: tuple[Edit, ...] = (flip, cut, insert, word, word, word, line, encoding)


# --- edits that know the structure -----------------------------------------------------------------------------------

VALUES: list[Any] = [
    None, True, 0, -1, 1e308, -1e-320, "", "x" * 5000, "\ud800", "\x1b[2J", [], {}, [[]], [[1, 2], [3]], [None],
    10**400, {"a": {"b": []}}, [1] * 3000, "inf", "certified", "robustlab.controller/9", [["u", "V"]], 2**63,
]  # fmt: skip


def json_node(rng: random.Random, raw: bytes) -> bytes:
    """One value somewhere in the JSON is another one, or missing."""
    root = {"root": json.loads(raw)}
    places: list[tuple[Any, Any]] = []
    pending: list[Any] = [root]
    while pending:
        node = pending.pop()
        for key in list(node) if isinstance(node, dict) else range(len(node)):
            places.append((node, key))
            if isinstance(node[key], (dict, list)):
                pending.append(node[key])
    node, key = rng.choice(places)
    other, there = rng.choice(places)
    action = rng.randrange(4)
    if action == 0 and node is not root:
        del node[key]
    elif action == 1 and isinstance(node, dict) and node is not root:
        node[f"{key}x"] = node.pop(key)
    elif action == 2:
        node[key] = json.loads(json.dumps(other[there]))
    else:
        node[key] = rng.choice(VALUES)
    return json.dumps(root["root"]).encode()


def hdf5_object(rng: random.Random, raw: bytes) -> bytes:
    """One object, attribute or link of an HDF5 file is another one."""
    image = io.BytesIO(raw)
    with h5py.File(image, "r+") as file:
        paths: list[str] = []
        file.visit(paths.append)
        path = rng.choice(paths or ["/"])
        thing = file[path]
        match rng.randrange(10):
            case 0:
                del file[path]
            case 1:
                file.move(path, path + rng.choice(("x", "%", "é", " ", "A")))
            case 2:
                file[f"{path}_l"] = rng.choice((h5py.SoftLink(path), h5py.ExternalLink("other.h5", "/A"), thing))
            case 3 | 4:
                _attribute(rng, rng.choice((file, thing)))
            case 5 if isinstance(thing, h5py.Dataset) and thing.size and thing.dtype.kind in "fi":
                index = tuple(rng.randrange(n) for n in thing.shape)
                thing[index] = rng.choice((np.nan, np.inf, 1e308, 0.0, -1.0, 1e-320)) if thing.dtype.kind == "f" else 7
            case 6 | 7:
                del file[path]
                if rng.random() < 0.2:
                    file.create_group(path)
                else:
                    file[path] = rng.choice(_hostile(rng))
            case 8:
                file.create_dataset(
                    f"{path}_z", (1500, 1500), dtype=rng.choice("bf"), chunks=(500, 500), compression=9
                )[...] = 0
            case _:
                pass
        if rng.random() < 0.7:  # with its hash, the file is refused before anybody looks at the structure
            file.attrs.pop("content_sha256", None)
        file.flush()
    return image.getvalue()


def _hostile(rng: random.Random) -> list[Any]:
    return [
        np.zeros((0, 3)), np.zeros((3, 0)), np.float64(1.0), np.ones((2, 2, 2)), np.array([[1 + 2j]]),
        np.ones((2, 2), bool), b"text", np.array(["a", "\x1b[31m"], dtype=h5py.string_dtype()),
        np.full((3, 3), np.nan), np.ones(3, ">i2"),
        np.full(2, 2**63 + 5, np.uint64), np.zeros(2, [("a", "f8"), ("b", "i4")]), np.ones((2, 2), np.float16),
        np.full((2, 2), -1, np.int64), h5py.Empty("f8"), np.array([b"\xff\xfe"]), np.arange(rng.randrange(1, 50) * 1.0),
        np.frombuffer(b"\x01" * 8, "V8"), np.array("x" * 60_000, dtype=h5py.string_dtype()),
    ]  # fmt: skip


def _attribute(rng: random.Random, thing: Any) -> None:
    name = rng.choice([*thing.attrs, "dt", "Ts", "sequence", "null", "MATLAB_class", "OCTAVE_NEW_FORMAT", "format"])
    value = rng.choice(
        (0, -1, 1e400, np.nan, 2**62, "", "x" * 3000, "robustlab", "9.9", np.ones(3), np.zeros(0), b"\xff")
    )
    if rng.random() < 0.3:
        thing.attrs.pop(name, None)
    else:
        thing.attrs[name] = value


def matlab_variables(rng: random.Random, raw: bytes) -> bytes:
    """Other variables in a MATLAB file: another class, nested, empty, many."""
    content = {k: v for k, v in scipy.io.loadmat(io.BytesIO(raw)).items() if not k.startswith("__")}
    name = rng.choice([*content, "new"])
    deep: Any = 1.0
    for _ in range(rng.choice((3, 15, 40))):
        deep = {"s": deep}
    content[name] = rng.choice((
        np.zeros((0, 3)), "text", np.array(["a", "b"], object), deep, np.ones((2, 2, 2)), np.full((2, 2), np.nan),
        scipy.sparse.csc_matrix((60_000, 60_000)), np.array([np.eye(2), "x"], object), np.zeros((3000, 3000), np.uint8),
        np.array([1 + 2j]), np.array(True), np.array([[b"x"]]), np.zeros(3, [("a", object), ("b", object)]),
        np.int8(-1),
    ))  # fmt: skip
    out = io.BytesIO()
    scipy.io.savemat(out, content, do_compression=rng.random() < 0.5)
    return out.getvalue()


STRUCTURAL = (json_node, hdf5_object, matlab_variables)


# --- readers ---------------------------------------------------------------------------------------------------------


def read_stored(path: Path, isolate: bool) -> tuple[Any, bool]:
    """Models, records, results: what `rl.load` takes."""
    loaded = interchange.read(path, isolate=isolate)
    return loaded.object, loaded.verified


def read_report(path: Path, isolate: bool) -> tuple[Any, bool]:
    """``robustlab report``: read, and written again as a page."""
    data = read_result(path.parent, isolate)
    write_report(data, path.parent)
    return data, False


def read_recipe(path: Path, isolate: bool) -> tuple[Any, bool]:
    """``robustlab recipe check``."""
    loaded = load_recipe(path, isolate=isolate)
    find_files(loaded)
    return loaded, False


def read_expressions(path: Path, isolate: bool) -> tuple[Any, bool]:
    """``robustlab uncertain build --expressions``."""
    return load_parametric(path, isolate), False


def digest(thing: Any) -> str:
    """Hash of all numbers and names of an object that came from a file."""
    tree = Tree()
    interchange._encode(tree, thing)
    return content_sha256(tree)


def readers(folder: Path) -> list[Reader]:
    """All of them, with good files made in the folder."""
    model = rl.StateSpaceModel(
        [[0, 1], [-2, -3]], [[0], [1]], [[1, 0]], [[0]], inputs=[("F", "N")], outputs=[("x", "m")], operating_point=None
    )
    inflow, level = rl.Signal("inflow", "m3/s"), rl.Signal("h", "m")
    motor = rl.plant("dc-motor", Kf=(4.8e-5, 0.35))
    controller = rl.Controller(model, gamma=1.25, status=rl.Status.CERTIFIED, method="test")
    record = rl.Record(np.arange(30) * 0.1, {"u": np.ones(30)}, {"q": np.sin(np.arange(30))}, {"u": "V", "q": "m"})
    things = {
        "state-space": model,
        "uncertain": motor.uncertain(outputs=["omega"]),
        "delayed": rl.with_delays(model, inputs={"F": 0.5}),
        "frequency-data": rl.frequency_data([0.5, 0.4 - 0.2j], [0.0, 1.0], radius=0.1),
        "controller": controller,
        "record": record,
        "result": Result("T", rl.Status.CERTIFIED, {"a": 1.5, "b": [1.0, 2.0], "c": {"x": None, "y": [[1], "t"]}}),
        "plant": rl.with_effects(motor, {"coulomb-friction": {"Fc": 0.005}}),
        "own plant": LinearPlant(
            "tank", {"area": Parameter("area", 2.0, "m2", 0.1)}, (inflow,), (level,), (level,), TANK
        ),
    }
    found = []
    for kind, thing in things.items():
        rl.save(folder / "x.h5", thing)
        raw = (folder / "x.h5").read_bytes()
        found.append(Reader(f"HDF5 {kind}", (("x.h5", raw),), read_stored, (*BYTES, *[hdf5_object] * 4), hashed=True))
    plain = (("x.h5", _plain()), ("x.h5", _pair()), ("x.h5", _octave()), ("x.mat", _matlab73()))
    found.append(Reader("HDF5 plain, Octave", plain[:3], read_stored, (*BYTES, *[hdf5_object] * 4)))
    found.append(Reader("MATLAB 7.3", plain[3:], read_stored, (*BYTES, *[hdf5_object] * 4)))
    matlab = (("x.mat", _matlab5(True)), ("x.mat", _matlab5(False)))
    found.append(Reader("MATLAB 5", matlab, read_stored, (*BYTES, *BYTES, matlab_variables)))
    tables = tuple(("x.csv", text.encode()) for text in TABLES)
    found.append(Reader("CSV", tables, read_stored, TEXT))
    export_controller(folder / "x.json", controller)
    exported = (("x.json", (folder / "x.json").read_bytes()),)
    found.append(Reader("JSON controller", exported, read_stored, (*TEXT, *[json_node] * 6)))
    result = (("result.json", json.dumps(RESULT, indent=1).encode()),)
    found.append(Reader("result.json", result, read_report, (*TEXT, *[json_node] * 6)))
    recipes = tuple(("x.toml", (ROOT / "recipes" / f"{n}.toml").read_bytes()) for n in RECIPES)
    found.append(Reader("TOML recipe", recipes, read_recipe, TEXT))
    expressions = (("x.toml", (ROOT / "models" / "springs.toml").read_bytes()), ("x.toml", EXPRESSIONS.encode()))
    found.append(Reader("TOML expressions", expressions, read_expressions, TEXT))
    return found


TABLES = (
    "t [s],u (V),q [m]\n" + "".join(f"{0.1 * i:.1f},{i},{i * i / 7:.6g}\n" for i in range(40)),
    "# t u q\n" + "".join(f"{0.1 * i:.1f} {i}  {i * i / 7:.6g}\n" for i in range(40)),
    "t;u;q\n" + "".join(f"{i};{i}.5;1e-{i}\n" for i in range(20)),
)
RECIPES = ("motor-data-sheet", "platform-models", "thesis-worst-cases")  # they read no files
EXPRESSIONS = """
A = [["-(k1 + k2)/m", "c*k1/(m + 2*k2)"], [1, "-1/(1/k1 + 1/k2)"]]
B = [["1/m"], [0.5]]
C = [["k1**2", 0]]
D = [[0]]
states = ["v", ["x", "m"]]
[parameters]
m = [3.0, 0.4]
k1 = [2.0, 1.4, 3.0]
k2 = {nominal = 1.0, low = 0.8, high = 1.5, unit = "N/m"}
c = 9.81
"""
TANK = lambda p: Descriptor(E=[[p["area"]]], F=[[-0.1]], G=[[1.0]], C=[[1.0]])  # noqa: E731
RESULT: dict[str, Any] = {
    "schema": "robustlab.result/1",
    "command": "run",
    "exit_code": 0,
    "requirements": [
        {"text": "fast", "that": "a.x", "condition": "at least 1", "value": 2.0, "met": True, "why_not": ""}
    ],
    "steps": [
        {
            "name": "a",
            "do": "plant",
            "title": "A",
            "status": "certified",
            "summary": "Did it.",
            "error": "",
            "trustworthy": True,
            "numbers": {"x": 2.0, "y": [1, 2]},
            "notes": ["mind"],
            "text": "a\n  b",
            "figures": [],
            "facts": [{"label": "speed", "value": "2 rad/s", "source": ""}],
            "seconds": 0.1,
        }
    ],
    "recipe": {
        "name": "r",
        "title": "",
        "description": "One.\n\nTwo.",
        "file": "r.toml",
        "sha256": "ab12",
        "overrides": {"seed": "7"},
        "text": "name = 1",
    },
    "seed": 7,
    "seconds": 1.25,
    "provenance": {"created": "2026-01-01", "inputs": {"m.h5": "cd34"}, "versions": {"numpy": "2.0"}},
    "files": ["report.html"],
}
MATRICES = {"A": [[0.0, 1.0], [-2.0, -3.0]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "D": [[0.0]]}


def _image(fill: Callable[[Any], None], **options: Any) -> bytes:
    image = io.BytesIO()
    with h5py.File(image, "w", **options) as file:
        fill(file)
    return image.getvalue()


def _plain() -> bytes:
    def fill(file: Any) -> None:
        for name, value in MATRICES.items():
            file.create_dataset(name, data=value, compression="gzip", fletcher32=True)
        file.attrs["dt"] = 0.1
        file["signals/input/name"], file["note"] = ["u"], "plain"

    return _image(fill)


def _pair() -> bytes:
    return _image(
        lambda f: [f.create_dataset(f"{g}/{n}", data=v) for g in ("nominal", "perturbed") for n, v in MATRICES.items()]
    )


def _octave() -> bytes:
    def fill(file: Any) -> None:
        for name, value in {**MATRICES, "Ts": 0.1}.items():
            group = file.create_group(name)
            group.attrs["OCTAVE_NEW_FORMAT"] = np.uint8(1)
            kind = "matrix" if np.ndim(value) else "scalar"
            group.create_dataset("type", data=np.bytes_(kind), dtype=f"S{len(kind) + 1}")
            group["value"] = np.array(value).T.copy()

    return _image(fill)


def _matlab73() -> bytes:
    def fill(file: Any) -> None:
        for name, value in MATRICES.items():
            file[name] = np.array(value).T.copy()
            file[name].attrs["MATLAB_class"] = np.bytes_("double")
        file["e"] = np.array([0, 3], np.uint64)
        file["e"].attrs["MATLAB_class"], file["e"].attrs["MATLAB_empty"] = np.bytes_("double"), np.uint8(1)
        file["s"] = np.array([[104], [105]], np.uint16)
        file["s"].attrs["MATLAB_class"] = np.bytes_("char")

    return _image(fill, userblock_size=512)


def _matlab5(compressed: bool) -> bytes:
    out = io.BytesIO()
    nested = {"x": np.arange(4.0), "names": np.array(["u", "yy"], object), "in": {"z": 1.0}}
    more = {"Ts": 0.1, "s": nested, "text": "hello", "sp": scipy.sparse.csc_matrix(np.eye(3)), "z": np.array([1 + 2j])}
    scipy.io.savemat(out, {**MATRICES, **more}, do_compression=compressed)
    return out.getvalue()


# --- mutants, in processes of their own -----------------------------------------------------------------------------


def mutants(reader: Reader, count: int, seed: int) -> Iterator[tuple[str, bytes]]:
    """File name and bytes of each mutant; the first ones are the good files."""
    rng = random.Random(f"{seed} {reader.name}")
    yield from reader.seeds
    for _ in range(count):
        name, raw = rng.choice(reader.seeds)
        edits = rng.choices(reader.edits, k=rng.choice((1, 1, 1, 2, 3)))
        # Edits of the structure first: the libraries behind them crash on what has been spoiled, as on any such file.
        for edit in sorted(dict.fromkeys(edits), key=lambda edit: edit not in STRUCTURAL):
            with contextlib.suppress(KeyError, ValueError, TypeError, OSError, RuntimeError):  # it does not fit here
                raw = edit(rng, raw) or b"\n"
        yield name, raw


def judge(reader: Reader, path: Path, truths: set[str], isolate: bool) -> tuple[str, str]:
    """Outcome and message of one file, in this process."""
    try:
        thing, verified = reader.read(path, isolate)
        if verified and digest(thing) not in truths:
            return "silent", "verified, and other numbers than were written"
        return ("verified" if verified else "read"), ""
    except RobustlabError as error:
        text = str(error)
        clear = len(error.line) <= 4000 and all(ch.isprintable() or ch == "\n" for ch in text)
        return ("refused" if clear else "unclear"), text[:300]
    except MemoryError:
        return "memory", "MemoryError"
    except Exception as error:  # noqa: BLE001  that is what is looked for
        import traceback

        return "traceback", f"{type(error).__name__}: {error}\n{traceback.format_exc()[-1500:]}"


def in_a_child(reader: Reader, paths: list[Path], truths: set[str]) -> list[tuple[str, str, float, int]]:
    """The same in a forked process, file after file as far as it gets: outcome, message, processor seconds, bytes."""
    ends = os.pipe()
    pid = os.fork()
    if not pid:
        _child(reader, paths, truths, ends[1])
    os.close(ends[1])
    answers = b""
    while select.select([ends[0]], [], [], WALL)[0] and (piece := os.read(ends[0], 1 << 16)):
        answers += piece
    os.close(ends[0])
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)  # one that sleeps; nothing to a process that has ended
    _, status, usage = os.wait4(pid, 0)
    found = [tuple(json.loads(answer)) for answer in answers.split(b"\n") if answer]
    if len(found) < len(paths):
        memory = max(0, usage.ru_maxrss * 1024 - _resident())
        # The library crashed, or ran in circles: the public reader has a process of its own for that.
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        outcome, text = judge(reader, paths[len(found)], truths, True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
        slow = seconds > SECONDS or (outcome != "refused" and os.WIFSIGNALED(status))
        found.append(("hang" if slow else "contained" if outcome == "refused" else outcome, text, seconds, memory))
    return found


def _child(reader: Reader, paths: list[Path], truths: set[str], end: int) -> None:
    # Limits are for what reading takes, whatever the process that forks has grown to.
    most, had = _mapped() + ADDRESS_SPACE, _resident()
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    faulthandler.disable()  # a crash of a library is an outcome here, and told as one
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
    warnings.simplefilter("ignore")
    for path in paths:
        signal.setitimer(signal.ITIMER_PROF, SECONDS)  # of processor time; its signal ends the process
        begun = time.process_time()
        outcome, text = judge(reader, path, truths, False)
        memory = max(0, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 - had)
        answer = ("memory" if memory > MEMORY else outcome, text, time.process_time() - begun, memory)
        os.write(end, json.dumps(answer).encode() + b"\n")
        if memory > MEMORY:
            break  # the next one starts afresh
    os._exit(0)


def _mapped() -> int:
    """Bytes of address space of this process."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


def _resident() -> int:
    """Bytes of memory that this process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def attack(reader: Reader, count: int, seed: int, folder: Path, isolated_every: int = 0) -> Found:
    """Read all mutants of one reader; every so many are read through the public reader with its own process too."""
    found = Found()
    truths = {digest(reader.read(_laid(folder, 0, name, raw), False)[0]) for name, raw in reader.seeds if reader.hashed}
    every = enumerate(mutants(reader, count, seed))
    while batch := [(n, raw, _laid(folder, n % BATCH, name, raw)) for n, (name, raw) in itertools.islice(every, BATCH)]:
        while batch:
            for result in in_a_child(reader, [path for _, _, path in batch], truths):
                n, raw, path = batch.pop(0)
                _note(found, reader, n, raw, _again(reader, n, path, truths, result, isolated_every))
    return found


def _laid(folder: Path, n: int, name: str, raw: bytes) -> Path:
    """The mutant as a file, in a folder of its own."""
    place = folder / str(n)
    place.mkdir(exist_ok=True)
    (place / name).write_bytes(raw)
    return place / name


def _again(
    reader: Reader, n: int, path: Path, truths: set[str], result: tuple[str, str, float, int], every: int
) -> tuple[str, str, float, int]:
    """Compare with the public reader, and the good files with what they must give."""
    outcome, text, *rest = result
    if n < len(reader.seeds) and outcome not in ("read", "verified"):
        return "traceback", f"the good file is not read: {text}", *rest
    if every and n % every == 0 and outcome in ("read", "verified", "refused"):
        again, words = judge(reader, path, truths, True)
        if again != outcome:
            return "traceback", f"{outcome} here, {again} in the reader process: {words}", *rest
    return result


def _note(found: Found, reader: Reader, n: int, raw: bytes, result: tuple[str, str, float, int]) -> None:
    outcome, text, seconds, memory = result
    found.counts[outcome] += 1
    found.largest, found.slowest = max(found.largest, memory), max(found.slowest, seconds)
    if outcome in FAULTS:
        found.faults.append((outcome, f"{reader.name} {n}: {text}", raw))


def main(count: int, seed: int = 1) -> int:
    """Attack every reader, print the table; the number of faults."""
    import platform

    import robustlab.provenance as origin

    versions = origin.library_versions()
    day = time.strftime("%Y-%m-%d")
    print(f"python benchmarks/fuzz.py {count} {seed}, on {day}; {platform.machine()}, {os.cpu_count()} cores")
    print(
        ", ".join(f"{name} {versions[name]}" for name in ("robustlab", "python", "numpy", "scipy", "h5py")), flush=True
    )
    columns = ("mutants", "read", "verified", "refused", "contained", *FAULTS)
    print(f"\n{'':20}" + "".join(f"{name:>10}" for name in (*columns, "slowest/s", "most/MB")), flush=True)
    total: Counter[str] = Counter()
    faults = 0
    with tempfile.TemporaryDirectory() as place:
        for reader in readers(Path(place)):
            folder = Path(tempfile.mkdtemp(dir=place))
            found = attack(reader, count, seed, folder, isolated_every=100)
            counts = found.counts | Counter(mutants=sum(found.counts.values()))
            row = "".join(f"{counts[name]:10d}" for name in columns)
            print(f"{reader.name:20}{row}{found.slowest:10.2f}{found.largest / 1e6:10.0f}", flush=True)
            total += counts
            faults += len(found.faults)
            for i, (outcome, text, raw) in enumerate(found.faults[:20]):
                print(f"  {outcome}: {text}", file=sys.stderr, flush=True)
                kept = Path(tempfile.gettempdir()) / f"fuzz-{reader.name.replace(' ', '-')}-{i}"
                kept.write_bytes(raw)
            shutil.rmtree(folder)
    print(f"{'all':20}" + "".join(f"{total[name]:10d}" for name in columns))
    return faults


if __name__ == "__main__":
    sys.exit(1 if main(int(sys.argv[1]), int((sys.argv[2:] or ["1"])[0])) else 0)
