"""Files of other programs that are not read here, each with the two lines that make it readable."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

from robustlab.errors import InputError

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
    ".parquet",
    (
        "import pandas; d = pandas.read_pickle({file!r})  # runs what is in it: only files of your own",
        "d.to_parquet({made!r})",
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
    "a Feather file", ".parquet", ("import pandas; d = pandas.read_feather({file!r})", "d.to_parquet({made!r})")
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
    ".tdms": _TDMS,
    **dict.fromkeys((".mf4", ".mdf"), _MDF),
}


def refusal(path: Path, formats: str) -> InputError | None:
    """What is said of a file by its suffix: that it is not read, and how it can be; None of any other.

    ``formats``: what is read, in words.
    """
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
