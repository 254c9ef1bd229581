"""Results that are tables: columns with units over one index, convertible to pandas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas


@dataclass(frozen=True)
class Table:
    """Columns over one index."""

    index: tuple[str, Sequence[Any] | np.ndarray]  # its name, and its values or names, (n,)
    columns: Mapping[str, Sequence[Any] | np.ndarray]  # name -> values, (n,)
    units: Mapping[str, str] = field(default_factory=dict)  # name of the index or of a column -> unit, if any


class Tabular:
    """Base of results that are tables, defined in `table`."""

    def table(self) -> Table:
        """Return the result as columns with units over one index."""
        raise NotImplementedError

    def to_pandas(self) -> pandas.DataFrame:
        """Return the result as a data frame of pandas (extra ``frames``), with units in ``attrs["units"]``."""
        from robustlab.files.records import need

        need(f"{type(self).__name__}.to_pandas", "pandas", "frames")
        import pandas

        table = self.table()
        name, values = table.index
        frame = pandas.DataFrame(dict(table.columns), index=pandas.Index(values, name=name))
        frame.attrs = {"units": dict(table.units)}
        return frame
