"""Results that are tables: columns with units over one index, as pandas takes them."""

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
    # Name of the index or of a column -> unit; what has none is left out.
    units: Mapping[str, str] = field(default_factory=dict)


class Tabular:
    """Base of results that are tables; a class says which in `table`."""

    def table(self) -> Table:
        """The result as columns with units over one index."""
        raise NotImplementedError

    def to_pandas(self) -> pandas.DataFrame:
        """The result as a data frame of pandas (extra ``frames``); units are in ``attrs["units"]``.

        Raises
        ------
        DependencyMissing
            pandas is not installed.
        """
        from robustlab.files.frames import need

        need(f"{type(self).__name__}.to_pandas", "pandas", "frames")
        import pandas

        table = self.table()
        name, values = table.index
        frame = pandas.DataFrame(dict(table.columns), index=pandas.Index(values, name=name))
        frame.attrs = {"units": dict(table.units)}
        return frame
