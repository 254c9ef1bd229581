"""The content of a file as plain arrays (groups, datasets, attributes), its hash, and the header of format 1."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from robustlab.arrays import AnyArray
from robustlab.errors import InputError, did_you_mean
from robustlab.provenance import Provenance

FORMAT = "robustlab"
FORMAT_VERSION = "1.0"
KINDS = (
    "state-space", "uncertain", "delayed", "frequency-data", "lpv", "controller", "lpv-controller", "record", "result",
    "plant",
)  # fmt: skip
ATTRIBUTES = ("format", "format_version", "kind", "content_sha256")


@dataclass(frozen=True)
class Unread:
    """A placeholder for values that were not read, because of their type or because they are not needed."""

    dtype: str  # name of the type, for messages
    shape: tuple[int, ...]


@dataclass
class Dataset:
    """Values (float64, int64, bool, complex128 or text) and the attributes of one dataset."""

    values: AnyArray | Unread
    attrs: dict[str, Any] = field(default_factory=dict)


@dataclass
class Tree:
    """One group of a file."""

    attrs: dict[str, Any] = field(default_factory=dict)  # name -> text, number, or array
    groups: dict[str, Tree] = field(default_factory=dict)
    datasets: dict[str, Dataset] = field(default_factory=dict)
    path: str = "/"  # of the group in the file
    file: str = "file"  # name of the file in messages

    def child_path(self, name: str) -> str:
        return f"{self.path.rstrip('/')}/{name}"

    def group(self, name: str) -> Tree:
        """Return the child group, new if needed."""
        return self.groups.setdefault(name, Tree(path=self.child_path(name), file=self.file))

    def put(self, name: str, values: Any, **attrs: Any) -> Dataset:
        """Add a dataset with values of canonical type."""
        where = self.child_path(name)
        given = {key: canonical(item, f"{where}@{key}") for key, item in attrs.items()}
        self.datasets[name] = Dataset(canonical(values, where), given)
        return self.datasets[name]

    def find(self, path: str) -> Tree | None:
        """Return the group at ``path`` relative to this one, or None."""
        node: Tree | None = self
        for part in filter(None, path.split("/")):
            node = node.groups.get(part) if node is not None else None
        return node

    def group_names(self) -> list[str]:
        """Return the paths of all groups below this one, without the leading slash."""
        return [path.strip("/") for path, item in self.walk() if isinstance(item, Tree) and item is not self]

    def walk(self) -> Iterator[tuple[str, Tree | Dataset]]:
        """Yield this group and all objects below it as (path, object)."""
        yield self.path, self
        for name, dataset in self.datasets.items():
            yield self.child_path(name), dataset
        for group in self.groups.values():
            yield from group.walk()


def type_name(values: AnyArray | Unread) -> str:
    return "text" if isinstance(values, np.ndarray) and values.dtype.kind == "U" else str(values.dtype)


def canonical(values: Any, where: str) -> AnyArray:
    """Return ``values`` as a C-ordered array of a type of format 1: float64, int64, bool, complex128, or text."""
    array = np.asarray(values)
    kind = array.dtype.kind
    if kind == "O" and array.size == 0:
        return np.zeros(array.shape, np.str_)
    if kind == "u" and array.size and int(array.max()) > np.iinfo(np.int64).max:
        raise InputError(where, "a whole number beyond 64 bits", "a smaller number")
    wanted = {"f": np.float64, "i": np.int64, "u": np.int64, "b": np.bool_, "c": np.complex128}
    if kind in wanted:
        return np.ascontiguousarray(array, dtype=wanted[kind]).reshape(array.shape)
    if kind == "U":
        for text in array.ravel().tolist():
            if "\x00" in text or any("\ud800" <= ch <= "\udfff" for ch in text):
                expected = "text without NUL characters, valid as UTF-8"
                raise InputError(where, f"text {text!r} cannot be stored", expected)
        return array
    raise InputError(where, f"dtype {array.dtype}", "numbers or text")


def content_sha256(tree: Tree) -> str:
    """Return the SHA-256 over the content as a hex string, independent of the file's layout.

    The root attribute ``content_sha256`` and the root group ``provenance`` are excluded; see ``docs/hdf5-format.md``.
    """
    digest = hashlib.sha256()
    objects = sorted(tree.walk(), key=lambda item: item[0].encode())
    for path, item in objects:
        if path == "/provenance" or path.startswith("/provenance/"):
            continue
        digest.update((b"D" if isinstance(item, Dataset) else b"G") + _text(path))
        if isinstance(item, Dataset):
            if isinstance(item.values, Unread):
                expected = "float64, int64, bool, complex128 or text"
                raise InputError(tree.file, f"{path} has dtype {item.values.dtype}", expected)
            digest.update(_array(item.values))
        for name in sorted(item.attrs, key=str.encode):
            if (path, name) != ("/", "content_sha256"):
                digest.update(b"A" + _text(name) + _array(canonical(item.attrs[name], path)))
    return digest.hexdigest()


def digest_beside_claims(tree: Tree) -> str:
    """Return the `content_sha256` of all but the root group ``claims``."""
    return content_sha256(replace(tree, groups={name: g for name, g in tree.groups.items() if name != "claims"}))


def _text(text: str) -> bytes:
    raw = text.encode()
    return str(len(raw)).encode() + b":" + raw


def _array(values: AnyArray) -> bytes:
    shape = ",".join(str(n) for n in values.shape)
    if values.dtype.kind == "U":
        return f"text({shape})".encode() + b"".join(_text(text) for text in values.ravel().tolist())
    name = {"f": "f8", "i": "i8", "b": "b1", "c": "c16"}[values.dtype.kind]
    little = values.astype(values.dtype.newbyteorder("<"), copy=False)
    return f"{name}({shape})".encode() + little.tobytes()


def link_name(name: str) -> str:
    """Return ``name`` as an HDF5 link name: ``%`` and ``/`` are written ``%25`` and ``%2F``; a leading dot ``%2E``."""
    escaped = name.replace("%", "%25").replace("/", "%2F")
    return "%2E" + escaped[1:] if escaped.startswith(".") else escaped or "%"


def signal_name(link: str) -> str:
    """Invert `link_name`."""
    return link.replace("%2E", ".").replace("%2F", "/").replace("%25", "%") if link != "%" else ""


# --- the header of format 1 ------------------------------------------------------------------------------------------


def text_attr(attrs: dict[str, Any], name: str) -> str | None:
    """Return the text attribute ``name``, or None where it is absent or no text."""
    value = np.asarray(attrs[name]) if name in attrs else np.zeros(0)
    return str(value.flat[0]) if value.dtype.kind == "U" and value.size == 1 else None


def one_number(value: Any) -> float | None:
    """Return the one real number in an attribute or in the values of a dataset, or None."""
    array = np.asarray(value)
    return float(array.flat[0]) if array.dtype.kind in "fi" and array.size == 1 else None


def stamp(tree: Tree, kind: str, provenance: Provenance) -> None:
    """Add provenance, header, hash, and the digest of the claims of a format 1 file to ``tree``."""
    group = tree.group("provenance")
    data = provenance.to_json()
    for name in ("created_by", "created", "note"):
        group.attrs[name] = str(data[name])
    if provenance.seed is not None:
        group.attrs["seed"] = provenance.seed
    for name, table in (("inputs", provenance.inputs), ("versions", provenance.versions)):
        group.group(name).attrs.update(table)
    for _path, item in tree.walk():
        item.attrs.update({key: canonical(value, tree.file) for key, value in item.attrs.items()})
    tree.attrs.update(format=FORMAT, format_version=FORMAT_VERSION, kind=kind)
    if "claims" in tree.groups:
        tree.groups["claims"].attrs["content_sha256"] = digest_beside_claims(tree)
    tree.attrs["content_sha256"] = content_sha256(tree)


def decode_provenance(tree: Tree) -> Provenance | None:
    """Return the provenance in a file, or None."""
    group = tree.groups.get("provenance")
    if group is None:
        return None
    data: dict[str, object] = {key: np.asarray(value).tolist() for key, value in group.attrs.items()}
    for name in ("inputs", "versions"):
        table = group.groups.get(name, Tree()).attrs
        data[name] = {key: str(np.asarray(value).tolist()) for key, value in table.items()}
    return Provenance.from_json(data)


def is_stamped(tree: Tree) -> bool:
    """Return whether the file has the header of format 1."""
    known = {"format_version", "content_sha256"} & set(tree.attrs)
    return bool(known) or text_attr(tree.attrs, "format") == FORMAT


def check_header(tree: Tree, no_verify: bool = False) -> tuple[str, list[str]]:
    """Return the kind of a format 1 file, and warnings."""
    where, attrs = tree.file, tree.attrs
    if text_attr(attrs, "format") != FORMAT:
        raise InputError(where, f"attribute format is {_shown(attrs, 'format')}", repr(FORMAT))
    version = text_attr(attrs, "format_version") or ""
    parsed = re.fullmatch(r"(\d{1,4})\.(\d{1,4})", version)
    if not parsed:
        raise InputError(where, f"attribute format_version is {_shown(attrs, 'format_version')}", f"{FORMAT_VERSION!r}")
    if int(parsed[1]) > 1:
        found = f"written by schema {version}, this robustlab reads <= 1.x; upgrade"
        raise InputError(where, found, None, "pip install --upgrade robustlab")
    if int(parsed[1]) < 1:
        raise InputError(where, f"written by schema {version}, which no robustlab ever wrote", f"{FORMAT_VERSION!r}")
    kind = text_attr(attrs, "kind")
    if kind not in KINDS:
        hint = did_you_mean(kind, KINDS) if kind else None
        raise InputError(where, f"attribute kind is {_shown(attrs, 'kind')}", f"one of {', '.join(KINDS)}", hint)
    return kind, _check_hash(tree, no_verify)


def _check_hash(tree: Tree, no_verify: bool) -> list[str]:
    stored = text_attr(tree.attrs, "content_sha256")
    if stored is None:
        for name in tree.attrs:
            if name not in ATTRIBUTES and did_you_mean(name, ["content_sha256"]):
                raise InputError(tree.file, f"unexpected attribute {name!r}", None, "did you mean content_sha256?")
        return ["the file carries no content_sha256: nothing shows that it is as it was written"]
    try:
        matches = content_sha256(tree) == stored
    except InputError:
        matches = False  # a dataset of a type that format 1 never writes
    if matches:
        return []
    if no_verify:
        return ["content_sha256 does not match; loaded all the same (--no-verify): certify nothing with it"]
    found = "/: checksum mismatch (content_sha256): the content was changed after it was written"
    raise InputError(tree.file, found, None, "make the file again, or look at it with no_verify=True")


def _shown(attrs: dict[str, Any], name: str) -> str:
    if name not in attrs:
        return "missing"
    text = text_attr(attrs, name)
    return repr(text[:40]) if text is not None else "no text"
