"""Spoiled binary files and tables: each mutant must be read or refused in one clear line, quickly, in little memory.

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
from fuzz_edits import BYTES, STRUCTURAL, Edit, hdf5_object, matlab_variables
from harness import heading

import robustlab as rl
from robustlab.dynamics import Descriptor, LinearPlant, Parameter
from robustlab.errors import RobustlabError
from robustlab.files import isolation
from robustlab.files.tree import Tree, content_sha256
from robustlab.result import Result
from robustlab.storage import interchange
from robustlab.storage.codecs import BY_KIND, codec_of

START = 4.0  # s of processor time that a reader process takes before it sees the file
FAULTS = ("traceback", "hang", "memory", "silent", "unclear")
SECONDS, WALL, MEMORY, BATCH = 5, 300, 1 << 30, 25
ADDRESS_SPACE = 4096 << 20  # as robustlab.files.isolation


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


def read_stored(path: Path, isolate: bool) -> tuple[Any, bool]:
    """Models, records, results: what `rl.load` takes."""
    loaded = interchange.read(path, isolate=isolate)
    return loaded.object, loaded.verified


def digest(thing: Any) -> str:
    """Hash of all numbers and names of an object that came from a file."""
    tree = Tree()
    (codec_of(thing) or BY_KIND["result"]).write(tree, thing)
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

    def hdf5(name: str, *seeds: tuple[str, bytes], hashed: bool = False) -> Reader:
        return Reader(name, seeds, read_stored, (*BYTES, *[hdf5_object] * 4), hashed)

    def pair(file: Any) -> None:
        file.update({f"{g}/{n}": v for g in ("nominal", "perturbed") for n, v in MATRICES.items()})

    found = []
    for kind, thing in things.items():
        rl.save(folder / "x.h5", thing)
        found.append(hdf5(f"HDF5 {kind}", ("x.h5", (folder / "x.h5").read_bytes()), hashed=True))
    matlab = tuple(("x.mat", _matlab5(compressed)) for compressed in (True, False))
    return [
        *found,
        hdf5("HDF5 plain", ("x.h5", _plain()), ("x.h5", _image(pair))),
        hdf5("MATLAB 7.3", ("x.mat", _matlab73())),
        Reader("MATLAB 5", matlab, read_stored, (*BYTES, *BYTES, matlab_variables)),
        Reader("CSV", tuple(("x.csv", table.encode()) for table in TABLES), read_stored, BYTES),
    ]


TABLES = (
    "t [s],u (V),q [m]\n" + "".join(f"{0.1 * i:.1f},{i},{i * i / 7:.6g}\n" for i in range(40)),
    "# t u q\n" + "".join(f"{0.1 * i:.1f} {i}  {i * i / 7:.6g}\n" for i in range(40)),
    "t;u;q\n" + "".join(f"{i};{i}.5;1e-{i}\n" for i in range(20)),
)
TANK = lambda p: Descriptor(E=[[p["area"]]], F=[[-0.1]], G=[[1.0]], C=[[1.0]])  # noqa: E731
MATRICES = {"A": [[0.0, 1.0], [-2.0, -3.0]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "D": [[0.0]]}


def _image(fill: Callable[[Any], object], **options: Any) -> bytes:
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
        memory = max(0, usage.ru_maxrss * 1024 - _pages(1))
        # The library crashed, or ran in circles: the public reader has a process of its own for that.
        isolation._SERVER.close()  # what it took for earlier files counts when it ends: now
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        outcome, text = judge(reader, paths[len(found)], truths, True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        seconds = after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
        slow = seconds > SECONDS + START or (outcome != "refused" and os.WIFSIGNALED(status))
        found.append(("hang" if slow else "contained" if outcome == "refused" else outcome, text, seconds, memory))
    return found


def _child(reader: Reader, paths: list[Path], truths: set[str], end: int) -> None:
    # Limits are for what reading takes, whatever the process that forks has grown to.
    most, had = _pages(0) + ADDRESS_SPACE, _pages(1)
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    faulthandler.disable()  # a crash of a library is an outcome here, and reported as one
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


def _pages(which: int) -> int:
    """Bytes of this process: 0, of address space; 1, in memory."""
    return int(Path("/proc/self/statm").read_text().split()[which]) * resource.getpagesize()


def attack(reader: Reader, count: int, seed: int, folder: Path, isolated_every: int = 0) -> Found:
    """Read all mutants of one reader; every so many are read through the public reader with its own process too."""
    found = Found()
    truths = {digest(reader.read(_laid(folder, 0, name, raw), False)[0]) for name, raw in reader.seeds if reader.hashed}
    every = enumerate(mutants(reader, count, seed))
    while batch := [(n, raw, _laid(folder, n % BATCH, name, raw)) for n, (name, raw) in itertools.islice(every, BATCH)]:
        while batch:
            for result in in_a_child(reader, [path for _, _, path in batch], truths):
                n, raw, path = batch.pop(0)
                outcome, words, seconds, memory = _compared(reader, n, path, truths, result, isolated_every)
                found.counts[outcome] += 1
                found.largest, found.slowest = max(found.largest, memory), max(found.slowest, seconds)
                if outcome in FAULTS:
                    found.faults.append((outcome, f"{reader.name} {n}: {words}", raw))
    return found


def _laid(folder: Path, n: int, name: str, raw: bytes) -> Path:
    """The mutant as a file, in a folder of its own."""
    place = folder / str(n)
    place.mkdir(exist_ok=True)
    (place / name).write_bytes(raw)
    return place / name


def _compared(
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


def main(count: int, seed: int = 1) -> int:
    """Attack every reader, print the table; the number of faults."""
    print(heading("robustlab", "numpy", "scipy", "h5py"), flush=True)
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
