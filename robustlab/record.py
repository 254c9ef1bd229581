"""Records: time series of inputs and outputs, measured or simulated."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike

from robustlab.arrays import Array
from robustlab.display import Displayable, Facts, number, short, with_units
from robustlab.errors import InputError, did_you_mean, unknown_name
from robustlab.provenance import Traced
from robustlab.signals import MAX_NAME, real_array
from robustlab.time_base import is_uniform

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True, init=False, eq=False)
class Record(Displayable, Traced):
    """Time series with strictly increasing times; immutable.

    Parameters
    ----------
    t
        Times in s, shape (n,), strictly increasing.
    inputs, outputs
        Name -> samples, each of shape (n,). Names are unique over both.
    units
        Name -> unit; empty (not stated) where left out.
    name
        Name of this record in messages and figures.
    meaning
        Name -> free text.

    Raises
    ------
    InputError
        Lengths that differ, NaN or Inf (with the index), times that do not increase (with the sample).

    Examples
    --------
    >>> r = Record([0.0, 0.1, 0.2], inputs={"u": [0, 1, 1]}, outputs={"q": [0.0, 0.1, 0.3]}, units={"u": "V", "q": "m"})
    >>> r.n, round(r.dt, 12), r.unit("q")
    (3, 0.1, 'm')
    """

    t: Array
    inputs: Mapping[str, Array]
    outputs: Mapping[str, Array]
    units: Mapping[str, str]
    name: str
    meaning: Mapping[str, str]

    quantities: ClassVar[Mapping[str, Any]] = {"samples": "1", "duration": "s", "dt": "s"}

    def __init__(
        self,
        t: ArrayLike,
        inputs: Mapping[str, ArrayLike] | None = None,
        outputs: Mapping[str, ArrayLike] | None = None,
        units: Mapping[str, str] | None = None,
        name: str = "record",
        meaning: Mapping[str, str] | None = None,
    ) -> None:
        clock = real_array("t", t, 1, name)
        if len(clock) < 2:
            raise InputError(name, f"{len(clock)} samples", "at least 2")
        step = np.diff(clock)
        if (step <= 0).any():
            k = int(np.argmax(step <= 0)) + 1
            word = "repeats the stamp before it" if step[k - 1] == 0 else "runs backwards"
            count = int((step <= 0).sum())
            found = f"t[{k}] = {clock[k]:.9g} s {word} ({count} such samples)"
            raise InputError(name, found, "strictly increasing times")
        ins = _channels({} if inputs is None else inputs, len(clock), name)
        outs = _channels({} if outputs is None else outputs, len(clock), name)
        twice = sorted(set(ins) & set(outs))
        if twice:
            raise InputError(name, f"signal {twice[0]!r} is both an input and an output", "unique names")
        known = [*ins, *outs]
        for argument, given in (("units", units), ("meaning", meaning)):
            if not isinstance(given, Mapping | None):
                raise InputError(f"{name}: {argument}", repr(given), "texts by names of signals, {...}, or None")
            for key in given or {}:
                if key not in known and key != "t":
                    found = f"a unit or meaning for {key!r}, which is no signal"
                    raise InputError(name, found, None, did_you_mean(key, known))
        texts = {key: str((units or {}).get(key, "")) for key in known}
        meanings = {key: str(text) for key, text in (meaning or {}).items()}
        vars(self).update(t=clock, inputs=ins, outputs=outs, units=texts, name=name, meaning=meanings)

    @property
    def n(self) -> int:
        """Number of samples."""
        return len(self.t)

    @property
    def duration(self) -> float:
        """Last time minus first time in s."""
        return float(self.t[-1] - self.t[0])

    @property
    def dt(self) -> float:
        """Mean sample time in s."""
        return self.duration / (self.n - 1)

    @property
    def is_uniform(self) -> bool:
        """Return whether every step is within 0.1 % of the mean sample time."""
        return is_uniform(self.t)

    def unit(self, name: str) -> str:
        """Return the unit of the named signal; empty where not stated."""
        self[name]
        return self.units[name]

    def __getitem__(self, name: str) -> Array:
        """Return the samples of the named signal."""
        for group in (self.inputs, self.outputs):
            if name in group:
                return group[name]
        known = [*self.inputs, *self.outputs]
        raise unknown_name(f"{self.name}: {name!r}", "no such signal", name, known)

    def between(self, start: float, stop: float) -> Record:
        """Return the samples with ``start <= t <= stop``; times are not shifted."""
        keep = (self.t >= start) & (self.t <= stop)
        inputs, outputs = ({k: v[keep] for k, v in side.items()} for side in (self.inputs, self.outputs))
        return replace(self, t=self.t[keep], inputs=inputs, outputs=outputs)

    @classmethod
    def read(
        cls,
        path: str | Path,
        group: str | None = None,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        dt: float | None = None,
        **options: Any,
    ) -> Record:
        """Read a measured record: HDF5 (format 1 or plain), MATLAB ``.mat``, CSV/TXT.

        Parameters
        ----------
        path
            The file; its content determines its kind.
        group
            HDF5 group or MATLAB struct that holds the signals.
        inputs, outputs
            Names of the signals to read; ``"u=SIGNAL"`` reads SIGNAL under the name u. With neither given, all are
            outputs; with inputs only, all others are.
        dt
            Sample time in s, in place of the file's. Signals of several time bases (logs of Simulink) are resampled to
            this sample time, or to the coarsest of theirs: inputs held, outputs interpolated; see ``meaning["t"]``.
        **options
            ``clock``, ``units``, ``delimiter``, ``decimal``, ``allow_gaps``, ``no_verify``; see
            `robustlab.files.records.read_record`. ``limits``, ``isolate``; see `robustlab.files.hdf5.read_tree`.
            Signals with a unit in ``units`` are converted to SI.

        Raises
        ------
        InputError
            Missing signals, columns that are no numbers, no times, missing samples.
        """
        from robustlab.files.records import read_record

        return cls(**read_record(path, group, inputs=inputs, outputs=outputs, dt=dt, **options))

    def to_pandas(self) -> pandas.DataFrame:
        """Return the record as a data frame of pandas (extra ``frames``).

        It has the index ``t`` in s, and a column for each signal, inputs first. ``attrs`` holds ``name``, ``units``,
        ``meaning``, ``inputs`` and ``outputs``, from which `from_pandas` makes the same record, bit for bit.

        Examples
        --------
        >>> frame = Record([0.0, 0.1], {"u": [0, 1]}, {"q": [0.0, 0.3]}, {"q": "m"}).to_pandas()
        >>> list(frame.columns), frame.index.name, frame.attrs["units"]
        (['u', 'q'], 't', {'t': 's', 'u': '', 'q': 'm'})
        """
        from robustlab.files.records import frame_of

        return frame_of(vars(self))

    @classmethod
    def from_pandas(
        cls,
        frame: pandas.DataFrame,
        inputs: Sequence[str] | None = None,
        outputs: Sequence[str] | None = None,
        units: Mapping[str, str] | None = None,
    ) -> Record:
        """Make a record of the columns of a data frame (extra ``frames``).

        Parameters
        ----------
        frame
            Rows are samples. The index has the times: numbers in s, durations, or dates (counted from the first); of
            numbered rows a column ``t`` or ``time``.
        inputs, outputs
            As in `read`; from ``frame.attrs`` where left out.
        units
            Unit of the numbers of a column, which are converted to SI. A unit in ``frame.attrs["units"]`` is a label.

        Raises
        ------
        InputError
            Columns that are no numbers, have one name, or are nested; NaN; no times, or times that do not increase.

        Examples
        --------
        >>> import pandas
        >>> frame = pandas.DataFrame({"u": [0.0, 1.0], "phi": [0.0, 180.0]})
        >>> frame.index = pandas.to_timedelta([0, 2], unit="ms")
        >>> r = Record.from_pandas(frame, ["u"], ["phi"], {"phi": "deg"})
        >>> r.t.tolist(), r["phi"].round(6).tolist(), r.unit("phi")
        ([0.0, 0.002], [0.0, 3.141593], 'rad')
        """
        from robustlab.files.records import keywords_of_frame

        return cls(**keywords_of_frame(frame, inputs, outputs, units))

    def numbers(self) -> dict[str, Any]:
        return {"samples": self.n, "duration": self.duration, "dt": self.dt}

    def to_json(self) -> dict[str, object]:
        """Return all samples as plain types."""
        return {"name": self.name, "t": self.t, "inputs": self.inputs, "outputs": self.outputs, "units": self.units}

    def facts(self) -> Facts:
        step = number(self.dt, "s")
        clock = f"every {step}" if self.is_uniform else f"{step} on average, not uniform"
        return [
            ("name", self.name),
            ("samples", f"{self.n}, {clock}, {number(self.duration, 's')} in all"),
            ("inputs", with_units((name, self.units[name]) for name in self.inputs)),
            ("outputs", with_units((name, self.units[name]) for name in self.outputs)),
        ]

    def __repr__(self) -> str:
        ins, outs = short(tuple(self.inputs)), short(tuple(self.outputs))
        return f"Record({self.name[:80]!r}: {self.n} samples, {self.duration:.6g} s, [{ins}] -> [{outs}])"


def _channels(given: Mapping[str, ArrayLike], n: int, where: str) -> dict[str, Array]:
    if not isinstance(given, Mapping):
        raise InputError(where, f"signals as a {type(given).__name__}", "a dict of name -> samples")
    channels: dict[str, Array] = {}
    for key, value in given.items():
        if not key or len(key) > MAX_NAME:
            raise InputError(where, f"signal name of {len(key)} characters", f"1 to {MAX_NAME} characters")
        samples = real_array(key, value, 1, where)
        if len(samples) != n:
            raise InputError(f"{where}: {key}", f"{len(samples)} samples", f"{n} to match t")
        channels[key] = samples
    return channels
