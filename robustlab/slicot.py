r"""SLICOT's routines as a second voice: the one door to slycot, behind which they run in a child process.

A routine of SLICOT that is given NaN never returns and cannot be interrupted; the child can be killed. slycot is
GPL-2.0 and stays a program of its own here: matrices go in, numbers come out, and nothing of robustlab rests on them.
They confirm or contradict what robustlab has proved (`robustlab.mu_analysis.cross_check`).
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.errors import DependencyMissing, EnvironmentFault, InputError, NoTrustworthyNumber

SECONDS = 120.0  # an answer takes milliseconds; what takes longer does not come
NO_SLYCOT = 3  # exit code of a child that has no slycot


def structured_norm_bounds(matrices: ArrayLike, sizes: Sequence[int], real: Sequence[bool]) -> Array:
    r"""Upper bounds of the structured singular value by ``AB13MD``, the D-G scalings of Fan, Tits and Doyle.

    ``matrices``: complex matrices, shape (k, n, n).
    ``sizes``: sizes of the square blocks of Delta, which add up to n.
    ``real``: which blocks are real scalars; those have size 1. All others are full complex blocks.
    Returns: bounds; NaN where the routine failed.
    Raises InputError: shapes that do not agree, NaN or Inf, a real block that is no scalar; DependencyMissing: slycot
    is not installed; NoTrustworthyNumber: the routine crashed or did not end.

    References
    ----------
    Fan, Tits, Doyle, "Robustness in the presence of mixed parametric uncertainty and unmodeled dynamics", IEEE TAC 36
    (1991).
    """
    stack = np.asarray(matrices, dtype=complex)
    n = sum(sizes)
    if stack.ndim != 3 or stack.shape[1:] != (n, n) or len(sizes) != len(real):
        raise InputError("AB13MD", f"matrices of shape {stack.shape}", f"(k, {n}, {n}) for blocks {list(sizes)}")
    if not np.isfinite(stack).all():
        raise InputError("AB13MD", "NaN or infinite entries", "finite matrices")
    if any(kind and size != 1 for kind, size in zip(real, sizes, strict=True)):
        raise InputError("AB13MD", "a repeated real block", "real blocks of size 1")
    types = np.where(np.asarray(real, dtype=bool), 1, 2)
    return _answer("ab13md", Z=stack, sizes=np.asarray(sizes, dtype=int), types=types)["bounds"]


def peak_gain(A: Array, B: Array, C: Array, D: Array, *, discrete: bool) -> float:
    """H-infinity norm of a stable model by ``AB13DD``; what it says of an unstable one is its gain on the boundary.

    Raises InputError: NaN or Inf; DependencyMissing: slycot is not installed; NoTrustworthyNumber: the routine failed,
    crashed or did not end.
    """
    if not all(np.isfinite(m).all() for m in (A, B, C, D)):
        raise InputError("AB13DD", "NaN or infinite entries", "finite matrices")
    gain = float(_answer("ab13dd", A=A, B=B, C=C, D=D, discrete=np.array(discrete))["gain"])
    if np.isnan(gain):
        raise NoTrustworthyNumber("AB13DD", "the routine failed")
    return gain


def _answer(routine: str, **arrays: Any) -> dict[str, Array]:
    """What the child says."""
    sent = io.BytesIO()
    np.savez(sent, **arrays)
    try:
        # -P: the folder the user happens to be in must not lend modules to the child.
        done = subprocess.run(  # noqa: S603  our own interpreter with our own module
            [sys.executable, "-P", "-m", "robustlab.slicot", routine],
            input=sent.getvalue(),
            capture_output=True,
            env=_environment(),
            timeout=SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise NoTrustworthyNumber(routine.upper(), f"no answer in {SECONDS:g} s") from None
    except OSError as error:
        raise EnvironmentFault(routine.upper(), f"the child process cannot be started ({error.strerror})") from error
    if done.returncode == NO_SLYCOT:
        raise DependencyMissing("slycot", "not installed", "the package slycot", "pip install slycot")
    if done.returncode:
        last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or [f"exit code {done.returncode}"]
        raise NoTrustworthyNumber(routine.upper(), f"the child process failed ({last[0][:200]})")
    with np.load(io.BytesIO(done.stdout), allow_pickle=False) as file:
        return {name: file[name] for name in file.files}


def _environment() -> dict[str, str]:
    root = str(Path(__file__).resolve().parents[1])
    path = os.pathsep.join(part for part in (root, os.environ.get("PYTHONPATH", "")) if part)
    return {**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "PYTHONUTF8": "1"}


def _ab13md(Z: Array, sizes: Array, types: Array) -> dict[str, Any]:
    from slycot import ab13md
    from slycot.exceptions import SlycotError

    bounds = np.full(len(Z), np.nan)
    for k, matrix in enumerate(Z):
        try:
            bounds[k] = ab13md(matrix, sizes, types)[0]
        except SlycotError:
            continue  # NaN says that there is no answer
    return {"bounds": bounds}


def _ab13dd(A: Array, B: Array, C: Array, D: Array, discrete: Array) -> dict[str, Any]:
    from slycot import ab13dd
    from slycot.exceptions import SlycotError

    n, m, p = len(A), B.shape[1], len(C)
    try:
        gain, _ = ab13dd("D" if discrete else "C", "I", "S", "D", n, m, p, A, np.eye(n), B, C, D, 1e-10)
    except SlycotError:
        gain = np.nan
    return {"gain": np.array(gain)}


def _child() -> None:
    """Read arrays from stdin, run the routine that the command line names, write its answer to stdout."""
    routine = {"ab13md": _ab13md, "ab13dd": _ab13dd}[sys.argv[1]]
    with np.load(io.BytesIO(sys.stdin.buffer.read()), allow_pickle=False) as file:
        arrays = {name: file[name] for name in file.files}
    try:
        found = routine(**arrays)
    except ImportError as error:
        print(error, file=sys.stderr)
        sys.exit(NO_SLYCOT)
    told = io.BytesIO()
    np.savez(told, **found)
    sys.stdout.buffer.write(told.getvalue())


if __name__ == "__main__":
    _child()
