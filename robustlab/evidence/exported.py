"""Claims as JSON for checkers of other hands: every number a hexadecimal double, so that none is rounded on the way."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.files.atomic import atomic_write
from robustlab.verification.claim import Claim

SCHEMA = "robustlab.claims/1"


def exported(claims: Sequence[Claim]) -> dict[str, Any]:
    """``{"schema", "claims": [{"claim": kind, "numbers": {name: {"shape", "real", "imag"?}}}]}``.

    Numbers are in the order of C, as Python's ``float.hex`` writes them; whole numbers in decimals.
    """
    return {
        "schema": SCHEMA,
        "claims": [
            {"claim": c.kind, "numbers": {k: _told(np.asarray(v)) for k, v in c.numbers.items()}} for c in claims
        ],
    }


def write_claims(path: str | Path, claims: Sequence[Claim]) -> Path:
    """Write the claims to a file of JSON. Raises EnvironmentFault: it cannot be written."""
    text = json.dumps(exported(claims), indent=1) + "\n"
    return atomic_write(path, lambda temporary: temporary.write_text(text, encoding="utf-8"))


def _told(values: NDArray[Any]) -> dict[str, Any]:
    if values.dtype.kind in "iub":
        return {"shape": list(values.shape), "whole": [int(x) for x in values.ravel()]}
    flat = [complex(x) for x in values.ravel()]
    told: dict[str, Any] = {"shape": list(values.shape), "real": [x.real.hex() for x in flat]}
    return {**told, "imag": [x.imag.hex() for x in flat]} if values.dtype.kind == "c" else told
