"""Claims out of a file, as arrays; what a file says of how they were found is not looked at."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from robustlab.errors import InputError
from robustlab.files.hdf5 import read_tree
from robustlab.files.tree import Dataset, Tree, Unread
from robustlab.verification.claim import Claim

GROUP = "claims"


def claims_in_file(path: str | Path) -> list[Claim]:
    """The claims that lie in the groups ``claims/0``, ``claims/1``, ... of an HDF5 file; none where there is no such
    group.

    A claim is a group with the attribute ``claim`` (its kind) and one dataset for each of its numbers. Raises
    InputError: no HDF5 file, a claim that is none, or the file of a controller with claims about other ones only.
    """
    root = read_tree(path)
    node = root.find(GROUP)
    claims = [] if node is None else [_claim(node.groups[name]) for name in sorted(node.groups, key=_order)]
    if claims and str(root.attrs.get("kind", "")) == "controller":
        K = {letter: _values(root, letter, root.datasets[letter]) for letter in "ABCD" if letter in root.datasets}
        if not any(is_about(claim, K) for claim in claims):
            raise InputError(root.file, "claims about other controllers only", "one about the controller in the file")
    return claims


def is_about(claim: Claim, K: Mapping[str, np.ndarray]) -> bool:
    """Whether the controller of the claim's loop has these matrices ``A .. D``, to the last bit."""
    named = [(letter, claim.numbers.get(f"K_{letter}")) for letter in "ABCD"]
    return all(own is not None and letter in K and np.array_equal(own, K[letter]) for letter, own in named)


def _order(name: str) -> tuple[int, str]:
    return (int(name) if name.isdigit() else len(name), name)


def _claim(node: Tree) -> Claim:
    kind = np.asarray(node.attrs.get("claim", ""))
    if kind.ndim != 0 or not str(kind):
        raise InputError(node.file, f"{node.path}: no attribute claim", "the kind of the claim")
    return Claim(str(kind), {name: _values(node, name, d) for name, d in node.datasets.items()})


def _values(node: Tree, name: str, dataset: Dataset) -> np.ndarray:
    if isinstance(dataset.values, Unread):
        raise InputError(node.file, f"{node.child_path(name)} has dtype {dataset.values.dtype}", "numbers")
    return dataset.values
