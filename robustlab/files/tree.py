"""A file's content as plain arrays: groups, datasets and attributes, and the hash over them."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robustlab.errors import InputError

__all__ = ["Dataset", "Tree", "Unread", "canonical", "content_sha256", "link_name", "signal_name"]


@dataclass(frozen=True)
class Unread:
    """Stands for the values of a dataset that was not read, because of its type or because nobody asked for it.

    Attributes
    ----------
    dtype
        Name of the type, for messages.
    shape
        Shape as the file states it.
    """

    dtype: str
    shape: tuple[int, ...]


@dataclass
class Dataset:
    """Values (float64, int64, bool, complex128 or text) and the attributes of one dataset."""

    values: NDArray[Any] | Unread
    attrs: dict[str, Any] = field(default_factory=dict)


@dataclass
class Tree:
    """One group of a file.

    Attributes
    ----------
    attrs
        Name -> text, number, or array.
    groups, datasets
        Name -> what is in it.
    path
        Where the group lies in the file; ``/`` is the root.
    file
        What messages call the file.
    """

    attrs: dict[str, Any] = field(default_factory=dict)
    groups: dict[str, Tree] = field(default_factory=dict)
    datasets: dict[str, Dataset] = field(default_factory=dict)
    path: str = "/"
    file: str = "file"

    def child_path(self, name: str) -> str:
        """Path of the named child."""
        return f"{self.path.rstrip('/')}/{name}"

    def group(self, name: str) -> Tree:
        """The named child group, made where it is not there yet."""
        return self.groups.setdefault(name, Tree(path=self.child_path(name), file=self.file))

    def put(self, name: str, values: Any, **attrs: Any) -> Dataset:
        """Add a dataset; the values are brought to their canonical type."""
        where = self.child_path(name)
        dataset = Dataset(
            canonical(values, where), {key: canonical(item, f"{where}@{key}") for key, item in attrs.items()}
        )
        self.datasets[name] = dataset
        return dataset

    def find(self, path: str) -> Tree | None:
        """The group at ``path`` relative to this one, or None."""
        node = self
        for part in path.strip("/").split("/"):
            if part:
                if part not in node.groups:
                    return None
                node = node.groups[part]
        return node

    def walk(self) -> Iterator[tuple[str, Tree | Dataset]]:
        """All objects below and including this group, as (path, object)."""
        yield self.path, self
        for name, dataset in self.datasets.items():
            yield self.child_path(name), dataset
        for group in self.groups.values():
            yield from group.walk()


def canonical(values: Any, where: str) -> NDArray[Any]:
    """``values`` as a C-ordered array of float64, int64, bool, complex128, or text: the types format 1 knows.

    Raises
    ------
    InputError
        Any other type, whole numbers beyond 64 bits, text that cannot be stored (NUL, half a surrogate pair).
    """
    array = np.asarray(values)
    kind = array.dtype.kind
    if kind in "O" and array.size == 0:
        return np.zeros(array.shape, np.str_)
    if kind == "u" and array.size and int(array.max()) > np.iinfo(np.int64).max:
        raise InputError(where, "a whole number beyond 64 bits", "a smaller number")
    wanted = {"f": np.float64, "i": np.int64, "u": np.int64, "b": np.bool_, "c": np.complex128}
    if kind in wanted:
        return np.ascontiguousarray(array, dtype=wanted[kind]).reshape(array.shape)
    if kind == "U":
        for text in array.ravel().tolist():
            if "\x00" in text or any("\ud800" <= ch <= "\udfff" for ch in text):
                raise InputError(
                    where, f"text {text!r} cannot be stored", "text without NUL characters, valid as UTF-8"
                )
        return array
    raise InputError(where, f"dtype {array.dtype}", "numbers or text")


def content_sha256(tree: Tree) -> str:
    """SHA-256 over the content, as a hex string; independent of how the file is laid out.

    Everything counts but the root attribute ``content_sha256`` and the root group ``provenance``. The bytes that are
    hashed are described in ``docs/hdf5-format.md``.

    Raises
    ------
    InputError
        A dataset has a type that format 1 does not know.
    """
    digest = hashlib.sha256()
    objects = sorted(tree.walk(), key=lambda item: item[0].encode())
    for path, item in objects:
        if path == "/provenance" or path.startswith("/provenance/"):
            continue
        digest.update((b"D" if isinstance(item, Dataset) else b"G") + _text(path))
        if isinstance(item, Dataset):
            if isinstance(item.values, Unread):
                raise InputError(
                    tree.file, f"{path} has dtype {item.values.dtype}", "float64, int64, bool, complex128 or text"
                )
            digest.update(_array(item.values))
        for name in sorted(item.attrs, key=str.encode):
            if (path, name) != ("/", "content_sha256"):
                digest.update(b"A" + _text(name) + _array(canonical(item.attrs[name], path)))
    return digest.hexdigest()


def _text(text: str) -> bytes:
    raw = text.encode()
    return str(len(raw)).encode() + b":" + raw


def _array(values: NDArray[Any]) -> bytes:
    shape = ",".join(str(n) for n in values.shape)
    if values.dtype.kind == "U":
        return f"text({shape})".encode() + b"".join(_text(text) for text in values.ravel().tolist())
    name = {"f": "f8", "i": "i8", "b": "b1", "c": "c16"}[values.dtype.kind]
    little = values.astype(values.dtype.newbyteorder("<"), copy=False)
    return f"{name}({shape})".encode() + little.tobytes()


def link_name(name: str) -> str:
    """``name`` as an HDF5 link name: ``%`` and ``/`` are written ``%25`` and ``%2F``; a leading dot as ``%2E``.

    Examples
    --------
    >>> link_name("dq/dt"), signal_name(link_name("100 %"))
    ('dq%2Fdt', '100 %')
    """
    escaped = name.replace("%", "%25").replace("/", "%2F")
    return "%2E" + escaped[1:] if escaped.startswith(".") else escaped or "%"


def signal_name(link: str) -> str:
    """Inverse of `link_name`."""
    return link.replace("%2E", ".").replace("%2F", "/").replace("%25", "%") if link != "%" else ""
