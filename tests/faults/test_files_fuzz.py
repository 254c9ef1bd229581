"""A few hundred spoiled files of every kind; benchmarks/fuzz.py runs thousands, and its figures are committed."""

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
    *("HDF5 plain", "MATLAB 7.3", "MATLAB 5", "CSV"),
]


@pytest.mark.parametrize("name", NAMES)
def test_spoiled_files_are_read_or_refused(every, name, tmp_path):
    found = fuzz.attack(every[name], 40, 2, tmp_path)
    assert [(outcome, text) for outcome, text, _ in found.faults] == []
    assert found.counts["refused"] > 10  # the attack bites
    assert found.counts["read"] + found.counts["verified"] >= len(every[name].seeds)


def test_every_reader_is_attacked(every):
    assert sorted(every) == sorted(NAMES)
