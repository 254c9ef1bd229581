"""Reads the claims of a file, as arrays; their origin in the file is ignored."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from robustlab.errors import InputError
from robustlab.files.hdf5 import read_tree
from robustlab.files.tree import Dataset, Tree, Unread, check_header, is_stamped
from robustlab.verification.claim import Claim

GROUP = "claims"


def claims_in_file(path: str | Path) -> list[Claim]:
    """Read the claims in the groups ``claims/0``, ``claims/1``, ... of an HDF5 file, by a kind and datasets each."""
    return claims_in(read_checked(path))


def read_checked(path: str | Path) -> Tree:
    """Read a file. Raises InputError: no HDF5 file, or a format 1 file with a wrong header or content hash."""
    root = read_tree(path)
    if is_stamped(root):
        check_header(root)
    return root


def claims_in(root: Tree) -> list[Claim]:
    """Return the claims of a file, in their order. Raises InputError: an invalid claim."""
    node = root.find(GROUP)
    if node is None:
        return []
    names = sorted(node.groups, key=lambda name: (int(name) if name.isdigit() else len(name), name))
    return [_claim(node.groups[name]) for name in names]


def _claim(node: Tree) -> Claim:
    kind = np.asarray(node.attrs.get("claim", ""))
    if kind.ndim != 0 or not str(kind):
        raise InputError(node.file, f"{node.path}: no attribute claim", "the kind of the claim")
    return Claim(str(kind), {name: _values(node, name, d) for name, d in node.datasets.items()})


def _values(node: Tree, name: str, dataset: Dataset) -> np.ndarray:
    if isinstance(dataset.values, Unread):
        raise InputError(node.file, f"{node.child_path(name)} has dtype {dataset.values.dtype}", "numbers")
    return dataset.values
