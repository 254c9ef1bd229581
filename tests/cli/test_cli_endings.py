"""Exit codes of the real command when pipes, streams or memory fail, and after signals."""

import os
import resource
import signal
import subprocess
import sys
import time
from pathlib import Path

import h5py
import pytest
from patience import PATIENCE
from shell import robustlab

import robustlab as rl

COMMAND = [sys.executable, "-c", "from robustlab.cli.main import main; main()"]
MODEL = rl.StateSpaceModel([[-1.0]], [[1.0]], [[1.0]], [[0.0]], inputs=[("u", "V")], outputs=[("y", "m")])


def ended(*arguments, **options):
    options = {"capture_output": True, "text": True, "timeout": 120, **options}
    return subprocess.run([*COMMAND, *map(str, arguments)], check=False, **options)


def in_shell(line, folder):
    """A line of bash in which R is the command; its stdout and stderr, where the line itself prints codes."""
    quoted = " ".join(f"'{word}'" for word in COMMAND)
    done = subprocess.run(
        ["bash", "-c", f'R() {{ {quoted} "$@"; }}\n{line}'],
        capture_output=True, text=True, cwd=folder, timeout=PATIENCE, check=False,
    )  # fmt: skip
    return done.stdout.strip(), done.stderr.strip()


def one_line(text):
    assert len(text.strip().splitlines()) == 1
    assert "Traceback" not in text
    return text


@pytest.fixture
def folder(tmp_path):
    rl.save(tmp_path / "m.h5", MODEL)
    return tmp_path


# --- stdout, stderr ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("words", "both"), [("--help", False), ("model show m.h5 --json", True)])
def test_a_closed_pipe_exits_with_141_and_no_message(folder, words, both):
    read, write = os.pipe()
    os.close(read)
    errors = write if both else subprocess.PIPE
    done = ended(*words.split(), capture_output=False, stdout=write, stderr=errors, cwd=folder)
    os.close(write)
    assert (done.returncode, done.stderr or "") == (141, "")


def test_a_reader_that_goes_early_never_makes_it_1(folder):
    codes, errors = in_shell(
        "for i in 1 2; do R recipe schema | head -1 >/dev/null; echo ${PIPESTATUS[0]}; done", folder
    )
    assert set(codes.split()) <= {"0", "141"}
    assert errors == ""


@pytest.mark.parametrize(("to", "message"), [(">&-", "stdout is closed"), (">/dev/full", "No space left on device")])
def test_closed_and_full_stdout_are_5(folder, to, message):
    code, errors = in_shell(f"R model show m.h5 --json {to}; code=$?; echo $code", folder)
    assert code == "5"
    assert message in one_line(errors)


def test_a_closed_or_full_stderr_loses_no_result_and_no_code(folder):
    out, _ = in_shell("R model show m.h5 2>&-; echo $?; R model show x.h5 2>/dev/full; echo $?", folder)
    assert "StateSpaceModel" in out
    assert out.splitlines()[-2:] == ["0", "3"]


def test_what_is_saved_while_stderr_is_closed_holds_no_messages(folder):
    # The number of a closed stream would go to the next file that is opened.
    in_shell("R model build dc-motor --out motor.h5 2>&- <&-", folder)
    assert rl.load(folder / "motor.h5").input_names == ("u",)


# --- memory ---------------------------------------------------------------------------------------------------


def test_memory_that_runs_out_is_5(folder):
    limit = 700 << 20
    words = ["uncertain", "sample", "u.h5", "-n", "2000", "--t-end", "1", "--points", "10000"]
    rl.save(folder / "u.h5", rl.plant("dc-motor").uncertain())
    done = ended(*words, cwd=folder, preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (limit, limit)))
    assert done.returncode == 5
    assert "not enough memory" in one_line(done.stderr)


# --- signals ----------------------------------------------------------------------------------------------------------


def children(pid):
    return [int(p) for p in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_sigterm_is_taken_as_ctrl_c(folder, number):
    rl.save(folder / "u.h5", rl.plant("dc-motor").uncertain(["omega"]))
    words = ["campaign", "run", "u.h5", "--outputs", "omega", "--input-value", "u=42", "--t-end", "0.1"]
    words += ["-n", "1000000", "--workers", "2", "--store", "s.sqlite"]
    process = subprocess.Popen(
        [*COMMAND, *words], cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        # A shell's background jobs ignore Ctrl-C, and so would this child of one.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )  # fmt: skip
    until = time.monotonic() + PATIENCE
    while len(workers := children(process.pid)) < 2 and time.monotonic() < until:
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)
    time.sleep(1.0)  # the last worker has read what it is to run: Python prints a traceback of one that cannot
    process.send_signal(number)
    out, errors = process.communicate(timeout=PATIENCE)
    assert (process.returncode, out) == (130, "")
    assert "interrupted" in errors  # what the workers print may follow
    assert "Traceback" not in errors
    until = time.monotonic() + PATIENCE
    while any(map(alive, workers)) and time.monotonic() < until:
        time.sleep(0.05)
    assert not any(map(alive, workers))


def test_a_warning_is_one_line_without_our_source(folder):
    with h5py.File(folder / "m.h5", "a") as file:
        del file.attrs["content_sha256"]
    done = ended("model", "diff", "m.h5", "m.h5", cwd=folder)
    assert done.returncode == 0
    lines = done.stderr.splitlines()
    assert lines
    assert all(line.startswith("warning: m.h5: the file carries no content_sha256") for line in lines)


def test_a_figure_whose_folder_cannot_be_made(tmp_path):
    (tmp_path / "file").write_text("no folder")
    rl.save(tmp_path / "u.h5", rl.UncertainModel(MODEL, []))
    ending = robustlab("mu", tmp_path / "u.h5", "--figure", tmp_path / "file" / "x.svg", code=5)
    assert "cannot be made" in one_line(ending.err.splitlines()[-1])


def test_a_terminal_with_ascii_only(tmp_path):
    done = ended("run", "motor-models", "--out", tmp_path / "out", env={**os.environ, "PYTHONIOENCODING": "ascii"})
    assert done.returncode == 0
    assert "Traceback" not in done.stderr
    assert "\\xb1" in done.stdout
