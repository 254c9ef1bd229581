"""Read HDF5 files of any origin into trees, and write trees that MATLAB, Octave and Julia can read."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.files.atomic import atomic_write
from robustlab.files.file_types import MIB, Limits, content_of
from robustlab.files.isolation import read_isolated, reader
from robustlab.files.matlab import from_matlab73
from robustlab.files.tree import Tree, Unread, canonical

COMPRESS_FROM = 64 << 10  # bytes
MAX_ATTRIBUTE_TEXT = 60_000  # bytes; HDF5 keeps attributes in a header of 64 KiB


def read_tree(path: str | Path, group: str | None = None, limits: Limits | None = None, isolate: bool = True) -> Tree:
    """Read an untrusted HDF5 or MATLAB (5, 7.3) file."""
    limits = limits or Limits()
    kind = content_of(path, limits)
    if kind == "text":
        raise InputError(str(path), "a text file", "an HDF5 or MATLAB file")
    options = {"group": group} if kind == "hdf5" else {}
    tree = read_isolated(kind, path, limits, **options) if isolate else reader(kind)(str(path), limits, **options)
    return from_matlab73(tree) if kind == "hdf5" else tree


def write_tree(path: str | Path, tree: Tree) -> Path:
    """Write ``tree`` to ``path`` atomically: datasets with fletcher32 checksums, texts as UTF-8."""
    import h5py

    # Laid out in memory first, so that a full disk fails in one plain write.
    with h5py.File("image.h5", "w", libver=("earliest", "v108"), driver="core", backing_store=False) as file:
        _write_group(file, tree)
        file.flush()
        image: bytes = file.id.get_file_image()
    return atomic_write(path, lambda temporary: temporary.write_bytes(image))


def _write_group(target: Any, tree: Tree) -> None:
    _write_attributes(target, tree.attrs, tree.path)
    for name, dataset in tree.datasets.items():
        path = tree.child_path(name)
        if isinstance(dataset.values, Unread):
            raise InputError(path, f"values of type {dataset.values.dtype}", "numbers or text")
        values = _storable(canonical(dataset.values, path))
        options: dict[str, Any] = {}
        if values.size and values.ndim:
            options["fletcher32"] = True
            if values.nbytes <= MIB:
                options["chunks"] = values.shape
            if values.nbytes >= COMPRESS_FROM:
                options.update(compression="gzip", compression_opts=4, shuffle=True)
        _write_attributes(target.create_dataset(name, data=values, **options), dataset.attrs, path)
    for name, group in tree.groups.items():
        _write_group(target.create_group(name), group)


def _write_attributes(target: Any, attrs: dict[str, Any], path: str) -> None:
    for name, value in attrs.items():
        text_or_numbers = canonical(value, f"{path}@{name}")
        values = _storable(text_or_numbers)
        if values.nbytes > MAX_ATTRIBUTE_TEXT:
            raise InputError(path, f"attribute {name} of {values.nbytes} bytes", f"at most {MAX_ATTRIBUTE_TEXT}")
        # A single text is stored with variable length, so that h5py reads it as str and not as bytes.
        single_text = text_or_numbers.dtype.kind == "U" and not text_or_numbers.ndim
        target.attrs.create(name, text_or_numbers.item() if single_text else values)


def _storable(values: AnyArray) -> AnyArray:
    """Return text as fixed-length UTF-8, which MATLAB, Octave and Julia read; numbers unchanged."""
    import h5py

    if values.dtype.kind != "U":
        return values
    raw = [text.encode() for text in values.ravel().tolist()]
    length = max((len(item) for item in raw), default=1) or 1
    return np.array(raw, dtype=h5py.string_dtype("utf-8", length)).reshape(values.shape)
