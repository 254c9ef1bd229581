"""A few hundred spoiled files of every kind; benchmarks/fuzz.py runs thousands, and its figures are committed."""

from __future__ import annotations

import mmap
import sys

import fuzz
import pytest

pytestmark = pytest.mark.skipif(not sys.platform.startswith("linux"), reason="forks, and limits what it forks")


@pytest.fixture(scope="module")
def every(tmp_path_factory):
    return {reader.name: reader for reader in fuzz.readers(tmp_path_factory.mktemp("good"))}


NAMES = [
    *(f"HDF5 {kind}" for kind in ("state-space", "uncertain", "delayed", "frequency-data", "controller", "record")),
    *(f"HDF5 {kind}" for kind in ("result", "plant", "own plant")),
    *("HDF5 plain", "MATLAB 7.3", "MATLAB 5", "CSV", "result.json", "TOML recipe"),
    "TOML expressions",
]


@pytest.mark.parametrize("name", NAMES)
def test_spoiled_files_are_read_or_refused(every, name, tmp_path):
    found = fuzz.attack(every[name], 40, 2, tmp_path)
    assert [(outcome, text) for outcome, text, _ in found.faults] == []
    assert found.counts["refused"] > 10  # the attack bites
    assert found.counts["read"] + found.counts["verified"] >= len(every[name].seeds)


def test_every_reader_is_attacked(every):
    assert sorted(every) == sorted(NAMES)


def test_the_harness_sees_what_it_looks_for(every, tmp_path):
    """A reader that is broken on purpose: a traceback, a silent change, a hang, memory."""
    good = every["HDF5 state-space"]

    def broken(path, _isolate):
        raw = path.read_bytes()
        if raw == b"loop":
            while True:
                pass
        if raw == b"grow":
            bytearray(fuzz.MEMORY + (1 << 26))[:: 1 << 12] = b"x" * ((fuzz.MEMORY + (1 << 26)) >> 12)
        if raw == b"key":
            raise KeyError("A")
        return fuzz.rl.StateSpaceModel([[1.0]], [[1.0]], [[1.0]], [[0.0]]), True

    reader = fuzz.Reader("broken", good.seeds, broken, good.edits, hashed=True)
    mapped = mmap.mmap(-1, 3 * fuzz.MEMORY)  # as in a process that has run for long: limits are not counted from 0
    outcomes = {}
    for raw in (b"key", b"grow", b"other"):
        path = fuzz._laid(tmp_path, 0, "x.h5", raw)
        outcomes[raw] = fuzz.in_a_child(reader, [path], {"the truth"})[0][0]
    mapped.close()
    assert outcomes == {b"key": "traceback", b"grow": "memory", b"other": "silent"}
