"""Run a snippet in a separate process, freely and under load; its output must be equal to the last bit.

Under load the process is stopped most of the time, and it has another number of BLAS threads.
"""

import dataclasses
import hashlib
import os
import subprocess
import sys
from collections.abc import Iterator, Mapping
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

__all__ = ["answer", "digest", "same_under_load"]

# Fields with computing times, which are not compared.
TIMES = {"seconds"}
# A child process stops the process for three quarters of the time, as a busy machine would. Busy loops would take the
# processor from other tests, and low priority would starve. The child continues the process before it checks for its
# own end.
STOPPING = """
import os, select, signal, time
process = os.getppid()
while True:
    os.kill(process, signal.SIGSTOP)
    time.sleep(0.03)
    os.kill(process, signal.SIGCONT)
    if select.select([0], [], [], 0.01)[0]:
        break
"""
# Imports and compilation of the first call run before the load, because they would take most of the time.
FRAME = """
import contextlib, io, subprocess, sys
import numpy as np
import robustlab as rl
from repeatable import STOPPING, digest
code = compile({snippet!r}, "snippet", "exec")
if {loaded}:
    with contextlib.redirect_stdout(io.StringIO()):
        exec(code, dict(rl=rl, np=np, digest=digest))
    load = subprocess.Popen([sys.executable, "-c", STOPPING], stdin=subprocess.PIPE)
try:
    exec(code, dict(rl=rl, np=np, digest=digest))
finally:
    if {loaded}:
        load.stdin.close()
        load.wait()
"""


def answer(snippet: str, *, loaded: bool = False, seconds: float = 600.0) -> str:
    """Return the output of a snippet, which may use ``rl``, ``np`` and ``digest``."""
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parent)}
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        environment.pop(name, None)
        if loaded:
            environment[name] = "1"
    code = FRAME.format(loaded=loaded, snippet=snippet)
    run = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True, timeout=seconds, check=False
    )
    assert run.returncode == 0, run.stderr
    return run.stdout


def same_under_load(snippet: str, seconds: float = 600.0) -> str:
    """Return the output of the snippet after checking that it is equal with and without load."""
    idle, loaded = answer(snippet, seconds=seconds), answer(snippet, loaded=True, seconds=seconds)
    assert idle == loaded
    assert idle.strip()
    return idle


def digest(*values: Any) -> str:
    """Return a hash of all bits of results (arrays, models, dataclasses) except computing times."""
    state = hashlib.sha256()
    for piece in _pieces(values):
        state.update(piece)
    return state.hexdigest()[:16]


def _pieces(value: Any) -> Iterator[bytes]:
    if isinstance(value, np.ndarray) and value.dtype.kind != "O":
        yield f"{value.dtype}{value.shape}".encode()
        yield np.ascontiguousarray(value).tobytes()
    elif value is None or isinstance(value, (str, bool, int, float, complex, np.generic, Enum, slice, Path)):
        yield repr(value).encode()
    elif isinstance(value, Mapping):
        yield b"{"
        for key, item in value.items():
            if key not in TIMES:
                yield from _pieces((key, item))
    elif dataclasses.is_dataclass(value):
        yield type(value).__name__.encode()
        yield from _pieces({f.name: getattr(value, f.name) for f in dataclasses.fields(value)})
    elif isinstance(value, (list, tuple, np.ndarray)):
        yield f"[{len(value)}".encode()
        for item in value:
            yield from _pieces(item)
    elif all(hasattr(value, name) for name in "ABCD"):
        yield from _pieces([value.A, value.B, value.C, value.D, value.dt])
    elif callable(value):
        yield b"function"
    elif hasattr(value, "to_json"):
        yield from _pieces(value.to_json())
    elif hasattr(value, "__dict__"):
        yield from _pieces({"type": type(value).__name__, **vars(value)})
    else:
        raise TypeError(f"{type(value).__name__} has no digest")
