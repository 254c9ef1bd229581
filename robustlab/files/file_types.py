"""Detect the kind of a file by its first bytes, reject files that are not read, and limit sizes."""

from __future__ import annotations

import json
import os
import stat
import tomllib
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from robustlab.errors import InputError, did_you_mean

MIB = 1 << 20
Content = Literal["hdf5", "matlab5", "text"]
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
BINARY_SUFFIXES = {
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".he5"), "an HDF5 file"),
    ".mat": "a MATLAB file of version 5 or 7.3",
}
_FORMATS = "HDF5, MATLAB (.mat) or text (.csv, .txt)"
_OTHERS = {
    b"SQLite format 3\x00": "an SQLite database",
    b"PK\x03\x04": "a zip archive (npz, xlsx, ...) is refused: it can hide any amount of data or code",
}


@dataclass(frozen=True)
class Limits:
    """Limits of reading, checked against declared sizes before anything is read."""

    file: int = 2048 * MIB  # bytes of the file
    dataset: int = 256 * MIB  # bytes of one dataset in memory
    total: int = 512 * MIB  # bytes of all datasets in memory
    document: int = 32 * MIB  # bytes of a document of JSON
    objects: int = 10_000  # groups and datasets
    depth: int = 16  # of nested groups
    name: int = 200  # characters
    seconds: float = 30.0  # processor time of the reader process


def size_text(n: int) -> str:
    """Return a number of bytes as text, such as 8 TB or 256 MiB."""
    for unit, scale in (("GiB", 30), ("MiB", 20)):
        if 0 < n < 1 << (scale + 10) and n % (1 << scale) == 0:
            return f"{n >> scale} {unit}"
    for unit, scale in (("EB", 1e18), ("PB", 1e15), ("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if n >= scale:
            return f"{n / scale:.4g} {unit}"
    return f"{n} bytes"


def require_file(path: str | Path, limits: Limits | None = None) -> bytes:
    """Return the first 520 bytes of ``path``, a regular, readable, non-empty file within the size limit."""
    path, limits = Path(path), limits or Limits()
    where, hint = str(path), None
    try:
        state = path.stat()
        if stat.S_ISDIR(state.st_mode):
            raise InputError(where, "is a directory", "a file")  # noqa: TRY301  treated like refusals of the system
        if not stat.S_ISREG(state.st_mode):
            raise InputError(where, "is not a regular file (a device, a pipe or a socket)", "a file")  # noqa: TRY301
        with path.open("rb") as stream:
            head = stream.read(520)
    except InputError:
        raise
    except FileNotFoundError:
        folder = path.absolute().parent
        if not folder.is_dir():
            raise InputError(where, f"no such file (there is no folder {folder})") from None
        with suppress(OSError):
            hint = did_you_mean(path.name, sorted(os.listdir(folder)))  # noqa: PTH208  names only
        raise InputError(where, f"no such file (looked in {folder})", None, hint) from None
    except PermissionError:
        raise InputError(where, "no permission to read it", None, f"chmod u+r {where}") from None
    except (OSError, ValueError) as error:  # a name too long, a NUL in the name, a loop of links, a dead network disk
        raise InputError(where, f"cannot be opened ({getattr(error, 'strerror', None) or error})") from None
    if state.st_size == 0:
        raise InputError(where, "empty file (0 bytes)", _FORMATS)
    if state.st_size > limits.file:
        raise InputError(where, f"{size_text(state.st_size)}", f"at most {size_text(limits.file)}")
    return head


def content_of(path: str | Path, limits: Limits | None = None) -> Content:
    """Return the kind of the file by its content."""
    path = Path(path)
    where = str(path)
    head = require_file(path, limits)
    if path.suffix.lower() in FOREIGN:
        raise _refusal(path, path.suffix.lower())
    if _is_hdf5(path, head):
        return "hdf5"
    if head[126:128] in (b"IM", b"MI") and (head[124:126] in (b"\x00\x01", b"\x01\x00")):
        return "matlab5"
    if path.suffix.lower() in BINARY_SUFFIXES:
        raise InputError(where, f"not {BINARY_SUFFIXES[path.suffix.lower()]} (first bytes {head[:4].hex(' ')})")
    for magic, words in _OTHERS.items():
        if head.startswith(magic):
            raise InputError(where, words, _FORMATS)
    pickled = head[:1] == b"\x80" and head[1:2] in b"\x02\x03\x04\x05"
    if pickled or head.startswith(b"\x93NUMPY"):
        kind = ".pkl" if pickled else ".npy"
        raise _refusal(path, kind, f"a pickle or npy file is {FOREIGN[kind][0]}")
    if b"\x00" in head:
        word = "UTF-16 text" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "unknown binary format"
        raise InputError(where, f"{word} (first bytes {head[:4].hex(' ')})", _FORMATS + " as UTF-8")
    return "text"


def _is_hdf5(path: Path, head: bytes) -> bool:
    """Search HDF5's signature at 0, 512, 1024, ..., after a user block (of 512 bytes in MATLAB's files)."""
    if head.startswith(HDF5_MAGIC):
        return True
    size, offset = path.stat().st_size, 512
    with path.open("rb") as stream:
        while offset + 8 <= size:
            stream.seek(offset)
            if stream.read(8) == HDF5_MAGIC:
                return True
            offset *= 2
    return False


# --- files of other programs ------------------------------------------------------------------------------------------

_CODE = "refused: such files can carry code that runs when they are read"
_TABLE = "import pandas; pandas.read_{}({{file!r}}).to_csv({{made!r}})"
# Suffix -> reason in the message, and code that converts such a file.
FOREIGN: dict[str, tuple[str, str]] = {
    ".npz": (_CODE, "d = numpy.load({file!r}); rl.save({made!r}, rl.Record(d['t'], {{'u': d['u']}}, {{'y': d['y']}}))"),
    ".npy": (_CODE, "numpy.savetxt({made!r}, numpy.load({file!r}), delimiter=',', header='t,u,y', comments='')"),
    **dict.fromkeys((".pkl", ".pickle"), (f"{_CODE}; open files of your own alone", _TABLE.format("pickle"))),
    **dict.fromkeys(
        (".yaml", ".yml"),
        ("refused: YAML tags can carry code, and it reads 1e-3 as text",
         "d = yaml.safe_load(open({file!r})); rl.save({made!r}, rl.ss(d['A'], d['B'], d['C'], d['D']))"),
    ),
    **dict.fromkeys((".xlsx", ".xlsm", ".xls", ".ods"), ("not read here: a spreadsheet", _TABLE.format("excel"))),
    ".parquet": ("not read here: a Parquet file", _TABLE.format("parquet")),
    **dict.fromkeys(
        (".slx", ".mdl"),
        ("not read here: a Simulink model",
         "[A, B, C, D] = linmod('{stem}'); save('{stem}.mat', 'A', 'B', 'C', 'D', '-v7')  % in MATLAB"),
    ),
}  # fmt: skip


def _refusal(path: Path, suffix: str, found: str = "") -> InputError:
    """Return the error for a file of another program, with the code that converts it."""
    why, line = FOREIGN[suffix]
    made = path.with_suffix(".h5" if "rl.save" in line else ".csv")
    hint = line.format(file=str(path), made=str(made), stem=path.stem.replace("'", "''"))
    return InputError(str(path), found or f"{suffix} files are {why}", _FORMATS, hint)


# --- documents: untrusted JSON and TOML as plain data of limited depth, safe for recursion ----------------------------

MAX_DEPTH = 64  # lists and tables in each other
WORD = {"json": "JSON", "toml": "TOML"}


def parse_document(kind: Literal["json", "toml"], raw: bytes, where: str) -> Any:
    """Return tables, lists, texts, numbers, booleans (and dates of TOML) of a file's bytes; ``where``: its name."""
    if len(raw) > Limits.document:
        raise InputError(where, f"{size_text(len(raw))} of {WORD[kind]}", f"at most {size_text(Limits.document)}")
    try:
        text = raw.decode("utf-8-sig" if kind == "json" else "utf-8")
    except UnicodeDecodeError as error:
        raise InputError(where, f"byte {error.start} is not UTF-8", f"{WORD[kind]} in UTF-8") from None
    try:
        data = (
            tomllib.loads(text) if kind == "toml" else json.loads(text, object_pairs_hook=_once, parse_constant=_none)
        )
        _check(data, 0)
    except json.JSONDecodeError as error:
        raise InputError(where, f"not valid JSON: {error.msg} (line {error.lineno}, column {error.colno})") from None
    except tomllib.TOMLDecodeError as error:
        raise InputError(where, f"not valid TOML: {error}") from None
    except RecursionError:
        found = f"not readable as {WORD[kind]}: nested too deeply"
        raise InputError(where, found, f"at most {MAX_DEPTH} levels") from None
    except ValueError as error:  # huge whole numbers, half a surrogate pair, errors raised below
        raise InputError(where, f"not readable as {WORD[kind]}: {str(error)[:100]}") from None
    return data


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    table = dict(pairs)
    if len(table) < len(pairs):
        seen: set[str] = set()
        twice = next(name for name, _ in pairs if name in seen or seen.add(name))
        raise ValueError(f"key {twice!r:.80} is written twice")
    return table


def _none(word: str) -> float:
    raise ValueError(f"{word} is among the numbers")


def _check(value: Any, depth: int) -> None:
    if depth > MAX_DEPTH:
        raise RecursionError
    if isinstance(value, dict):
        for key, item in value.items():
            key.encode()
            _check(item, depth + 1)
    elif isinstance(value, list):
        for item in value:
            _check(item, depth + 1)
    elif isinstance(value, str):
        value.encode()
    elif type(value) is int and not -(2**63) <= value < 2**63:
        raise ValueError("a whole number beyond 64 bits")
