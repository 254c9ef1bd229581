"""What a file is, by its first bytes; whether it may be read at all; and how large what comes from outside may be.

Files of other programs that are not read here are refused with the two lines that make each readable.
"""

from __future__ import annotations

import os
import stat
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, NamedTuple

from robustlab.errors import InputError, did_you_mean

MIB = 1 << 20
Content = Literal["hdf5", "matlab5", "text"]
HDF5_MAGIC = b"\x89HDF\r\n\x1a\n"
BINARY_SUFFIXES = {
    **dict.fromkeys((".h5", ".hdf5", ".hdf", ".he5"), "an HDF5 file"),
    ".mat": "a MATLAB file of version 5 or 7.3",
}
_FORMATS = "HDF5, MATLAB (.mat) or text (.csv, .txt)"


@dataclass(frozen=True)
class Limits:
    """What is read at most; everything is checked against the declared sizes before any of it is read."""

    # file, dataset, total: bytes of the file, of one dataset in memory, of all datasets in memory
    file: int = 2048 * MIB
    dataset: int = 256 * MIB
    total: int = 512 * MIB
    document: int = 32 * MIB  # bytes of a document of JSON
    # objects, depth: number of groups and datasets, and how deep groups may be nested
    objects: int = 10_000
    depth: int = 16
    name: int = 200  # characters of a name
    seconds: float = 30.0  # processor time that the reader process may take


def size_text(n: int) -> str:
    """A number of bytes as people write it.

    Examples
    --------
    >>> size_text(8 * 10**12), size_text(256 << 20)
    ('8 TB', '256 MiB')
    """
    if n >= 1 << 10 and n % (1 << 20) == 0 and n < 1 << 30:
        return f"{n >> 20} MiB"
    if n >= 1 << 30 and n % (1 << 30) == 0 and n < 1 << 40:
        return f"{n >> 30} GiB"
    for unit, scale in (("EB", 1e18), ("PB", 1e15), ("TB", 1e12), ("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if n >= scale:
            return f"{n / scale:.4g} {unit}"
    return f"{n} bytes"


def require_file(path: str | Path, limits: Limits | None = None) -> bytes:
    """First 520 bytes of ``path``, once it is a regular, readable, non-empty file within the size limit."""
    path = Path(path)
    where = str(path)
    limits = limits or Limits()
    try:
        state = path.stat()
        _check_state(state, where, limits)
        with path.open("rb") as stream:
            return stream.read(520)
    except InputError:
        raise
    except FileNotFoundError:
        raise _missing(path) from None
    except PermissionError:
        raise InputError(where, "no permission to read it", None, f"chmod u+r {where}") from None
    except (OSError, ValueError) as error:  # a name too long, a NUL in the name, a loop of links, a dead network disk
        raise InputError(where, f"cannot be opened ({getattr(error, 'strerror', None) or error})") from None


def _check_state(state: os.stat_result, where: str, limits: Limits) -> None:
    if stat.S_ISDIR(state.st_mode):
        raise InputError(where, "is a directory", "a file")
    if not stat.S_ISREG(state.st_mode):
        raise InputError(where, "is not a regular file (a device, a pipe or a socket)", "a file")
    if state.st_size == 0:
        raise InputError(where, "empty file (0 bytes)", _FORMATS)
    if state.st_size > limits.file:
        raise InputError(where, f"{size_text(state.st_size)}", f"at most {size_text(limits.file)}")


def _missing(path: Path) -> InputError:
    folder = path.absolute().parent
    if not folder.is_dir():
        return InputError(str(path), f"no such file (there is no folder {folder})")
    try:
        siblings = sorted(os.listdir(folder))  # noqa: PTH208  names only
    except OSError:
        siblings = []
    return InputError(str(path), f"no such file (looked in {folder})", None, did_you_mean(path.name, siblings))


def content_of(path: str | Path, limits: Limits | None = None) -> Content:
    """Kind of the file, by content and not by name."""
    path = Path(path)
    where = str(path)
    head = require_file(path, limits)
    refused = refusal(path, _FORMATS)
    if refused is not None:
        raise refused
    if _is_hdf5(path, head):
        return "hdf5"
    if head[126:128] in (b"IM", b"MI") and (head[124:126] in (b"\x00\x01", b"\x01\x00")):
        return "matlab5"
    if path.suffix.lower() in BINARY_SUFFIXES:
        raise InputError(where, f"not {BINARY_SUFFIXES[path.suffix.lower()]} (first bytes {head[:4].hex(' ')})")
    if head.startswith(b"SQLite format 3\x00"):
        raise InputError(where, "an SQLite database", _FORMATS)
    if head.startswith(b"PK\x03\x04"):
        raise InputError(
            where, "a zip archive (npz, xlsx, ...) is refused: it can hide any amount of data or code", _FORMATS
        )
    if head.startswith(b"\x93NUMPY") or (head[:1] == b"\x80" and head[1:2] in (b"\x02", b"\x03", b"\x04", b"\x05")):
        by_content = REFUSED[".npy" if head.startswith(b"\x93NUMPY") else ".pkl"]
        found = f"a pickle or npy file is refused: {by_content.why}"
        raise InputError(where, found, _FORMATS, *told(path, by_content))
    if b"\x00" in head:
        word = "UTF-16 text" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "unknown binary format"
        raise InputError(where, f"{word} (first bytes {head[:4].hex(' ')})", _FORMATS + " as UTF-8")
    return "text"


def _is_hdf5(path: Path, head: bytes) -> bool:
    """HDF5's signature stands at 0, 512, 1024, ...: a user block (MATLAB writes one of 512 bytes) may come first."""
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

_CODE = "such files can carry code that runs when they are read"
_PICKLES = "arrays of objects in such files are pickles, which can carry code"
_TAGS = "YAML tags can carry code, and it reads 1e-3 as text"


class Foreign(NamedTuple):
    """A kind of file: what it is or why it is refused, the suffix of what the lines write, and the two lines.

    In the lines {file}, {made} and {stem} stand for the file, what is written, and the name without folder and suffix.
    """

    why: str
    made: str
    lines: tuple[str, str]
    language: str = "Python"


_NPZ = Foreign(
    _PICKLES,
    ".h5",
    (
        "import numpy, robustlab as rl; d = numpy.load({file!r})  # of a model: rl.ss(*(d[k] for k in 'ABCD'))",
        "rl.save({made!r}, rl.Record(d['t'], {{'u': d['u']}}, {{'y': d['y']}}))",
    ),
)
_NPY = Foreign(
    _PICKLES,
    ".csv",
    (
        "import numpy; d = numpy.load({file!r})  # with columns t, u, y",
        "numpy.savetxt({made!r}, d, delimiter=',', header='t,u,y', comments='')",
    ),
)
_PICKLE = Foreign(
    _CODE,
    ".csv",
    (
        "import pandas; d = pandas.read_pickle({file!r})  # runs what is in it: only files of your own",
        "d.to_csv({made!r})",
    ),
)
_JOBLIB = _PICKLE._replace(
    lines=(
        "import joblib; d = joblib.load({file!r})  # runs what is in it: only files of your own",
        _PICKLE.lines[1],
    )
)
_SHEET = Foreign(
    "a spreadsheet",
    ".csv",
    ("import pandas; d = pandas.read_excel({file!r})", "d.to_csv({made!r}, index=False)"),
)
_SIMULINK = Foreign(
    "a Simulink model",
    ".mat",
    ("[A, B, C, D] = linmod('{stem}'); dt = 0;", "save('{made}', 'A', 'B', 'C', 'D', 'dt', '-v7')"),
    "MATLAB",
)
_FEATHER = Foreign(
    "a Feather file",
    ".csv",
    ("import pandas; d = pandas.read_feather({file!r})", "d.to_csv({made!r}, index=False)"),
)
_PARQUET = _FEATHER._replace(
    why="a Parquet file", lines=("import pandas; d = pandas.read_parquet({file!r})", _FEATHER.lines[1])
)
_MCAP = Foreign(
    "a ROS 2 bag",
    ".csv",
    (
        "from mcap_ros2.reader import read_ros2_messages as read; import numpy",
        (
            "numpy.savetxt({made!r}, [(m.log_time_ns / 1e9, m.ros_msg.data) for m in read({file!r}, '/TOPIC')], "
            "delimiter=',', header='t,u', comments='')"
        ),
    ),
)
_TDMS = Foreign(
    "a LabVIEW file",
    ".csv",
    ("from nptdms import TdmsFile; d = TdmsFile.read({file!r}).as_dataframe()", "d.to_csv({made!r}, index=False)"),
)
_MDF = Foreign(
    "an MDF file",
    ".csv",
    ("from asammdf import MDF; d = MDF({file!r}).to_dataframe()", "d.to_csv({made!r}, index_label='t')"),
)
_YAML = Foreign(
    _TAGS,
    ".h5",
    (
        "import yaml, robustlab as rl; d = yaml.safe_load(open({file!r}))",
        "rl.save({made!r}, rl.ss(d['A'], d['B'], d['C'], d['D']))",
    ),
)
REFUSED = {
    ".npz": _NPZ,
    ".npy": _NPY,
    ".pkl": _PICKLE,
    ".pickle": _PICKLE,
    ".joblib": _JOBLIB,
    ".yaml": _YAML,
    ".yml": _YAML,
}  # files that could be read, and are not
UNREAD = {
    **dict.fromkeys((".xlsx", ".xlsm", ".xls", ".ods"), _SHEET),
    **dict.fromkeys((".slx", ".mdl"), _SIMULINK),
    **dict.fromkeys((".feather", ".arrow"), _FEATHER),
    ".parquet": _PARQUET,
    ".mcap": _MCAP,
    ".tdms": _TDMS,
    **dict.fromkeys((".mf4", ".mdf"), _MDF),
}


def refusal(path: Path, formats: str) -> InputError | None:
    """What is said of a file by its suffix: that it is not read, and how it can be; None of any other."""
    suffix = path.suffix.lower()
    kind = REFUSED.get(suffix) or UNREAD.get(suffix)
    if kind is None:
        return None
    found = (
        f"{path.suffix} files are refused: {kind.why}" if suffix in REFUSED else f"{kind.why}, which is not read here"
    )
    return InputError(str(path), found, formats, *told(path, kind))


def told(path: Path, kind: Foreign) -> tuple[str, tuple[str, ...]]:
    """The hint, and the lines before it."""
    made = str(path.with_suffix(kind.made))
    quoted = made.replace("'", "''") if kind.language == "MATLAB" else made
    lines = [line.format(file=str(path), made=quoted, stem=path.stem.replace("'", "''")) for line in kind.lines]
    head = f"two lines of {kind.language} make it readable:"
    return f"then name {made} in its place", (head, *(f"  {line}" for line in lines))
