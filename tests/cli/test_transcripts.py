"""The output of commands, word for word: the numbers, tested in the unit tests, are replaced by #."""

import re
import shlex
from pathlib import Path

import pytest
from command_files import write_models
from shell import robustlab

TRANSCRIPTS = sorted((Path(__file__).parent / "transcripts").glob("*.txt"))


def masked(text: str) -> str:
    """Numbers of more than a digit, hashes and dates as #; rows and rules as wide as they are without."""
    text = re.sub(r"\b[0-9a-f]{12,64}\b|\d{4}-\d\d-\d\d[T ][\d:.+Z]+", "#", text)
    text = re.sub(r"(?<![\w#])[-+]?\d+(\.\d+(e[-+]?\d+)?|e[-+]?\d+)", "#", text)
    text = re.sub(r"(?<![\w#.])[-+]?\d{2,}(?!\w)", "#", text)
    return re.sub(r"(?m) +$", "", re.sub(r"(?<=\S) {2,}", "  ", re.sub(r"-{3,}", "---", text)))


@pytest.mark.parametrize("path", TRANSCRIPTS, ids=lambda path: path.stem)
def test_commands_print_the_transcript(path, tmp_path, monkeypatch, request):
    monkeypatch.chdir(tmp_path)
    write_models(tmp_path)
    made = ""
    for line in path.read_text(encoding="utf-8").splitlines():
        if line.startswith("$ "):
            ending = robustlab(*shlex.split(line)[2:])
            made += f"{line}\n{masked(ending.out)}{masked(ending.err)}[{ending.code}]\n\n"
    if request.config.getoption("--update"):
        path.write_text(made, encoding="utf-8")
    assert made == path.read_text(encoding="utf-8")
