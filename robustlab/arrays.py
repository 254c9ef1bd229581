"""Types of arrays in signatures: one set for the whole house."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

__all__ = ["AnyArray", "Array", "ComplexArray", "Indices", "Mask"]

Array = NDArray[np.floating[Any]]  # real, double precision throughout
ComplexArray = NDArray[np.complexfloating[Any, Any]]
AnyArray = NDArray[Any]  # real or complex, as the model or the matrix is
Mask = NDArray[np.bool_]
Indices = NDArray[np.intp]
