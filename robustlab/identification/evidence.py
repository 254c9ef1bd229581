"""What all parts of a comparison share: read-only arrays, and all fields as plain data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

__all__ = ["Evidence"]


@dataclass(frozen=True)
class Evidence:
    """Base of the parts of a result: arrays, also those in tables, become read-only when it is made."""

    def __post_init__(self) -> None:
        for value in vars(self).values():
            for item in value.values() if isinstance(value, Mapping) else (value,):
                if isinstance(item, np.ndarray):
                    item.setflags(write=False)

    def to_json(self) -> dict[str, object]:
        """All fields."""
        return dict(vars(self))
