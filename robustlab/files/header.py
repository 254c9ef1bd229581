"""The root of a format 1 file: format, version, kind, content hash, provenance."""

from __future__ import annotations

import re
from typing import Any

import numpy as np

from robustlab.errors import InputError, did_you_mean
from robustlab.files.tree import Tree, canonical, content_sha256
from robustlab.provenance import Provenance

__all__ = ["FORMAT", "FORMAT_VERSION", "KINDS", "check_header", "decode_provenance", "is_stamped", "stamp", "text_attr"]

FORMAT = "robustlab"
FORMAT_VERSION = "1.0"
KINDS = ("state-space", "uncertain", "controller", "record", "result", "plant")
ATTRIBUTES = ("format", "format_version", "kind", "content_sha256")


def text_attr(attrs: dict[str, Any], name: str) -> str | None:
    """The text attribute ``name``, or None where it is absent or no text."""
    value = np.asarray(attrs[name]) if name in attrs else np.zeros(0)
    return str(value.flat[0]) if value.dtype.kind == "U" and value.size == 1 else None


def stamp(tree: Tree, kind: str, provenance: Provenance) -> None:
    """Make ``tree`` a format 1 file of this kind: add provenance, header and hash."""
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
    tree.attrs["content_sha256"] = content_sha256(tree)


def decode_provenance(tree: Tree) -> Provenance | None:
    """The provenance that a file carries, or None."""
    group = tree.groups.get("provenance")
    if group is None:
        return None
    data: dict[str, object] = {key: np.asarray(value).tolist() for key, value in group.attrs.items()}
    for name in ("inputs", "versions"):
        table = group.groups.get(name, Tree()).attrs
        data[name] = {key: str(np.asarray(value).tolist()) for key, value in table.items()}
    return Provenance.from_json(data)


def is_stamped(tree: Tree) -> bool:
    """True where the file says that it is a format 1 file; plain files carry no header."""
    return (
        any(name in tree.attrs for name in ("format_version", "content_sha256"))
        or text_attr(tree.attrs, "format") == FORMAT
    )


def check_header(tree: Tree, no_verify: bool = False) -> tuple[str, list[str]]:
    """Kind of a format 1 file, and warnings.

    A file without a hash is accepted with a warning; one with a wrong hash with ``no_verify`` only.

    Raises
    ------
    InputError
        A newer major version, an unknown kind, a hash that does not match.
    """
    where, attrs = tree.file, tree.attrs
    if text_attr(attrs, "format") != FORMAT:
        raise InputError(where, f"attribute format is {_shown(attrs, 'format')}", repr(FORMAT))
    version = text_attr(attrs, "format_version") or ""
    parsed = re.fullmatch(r"(\d{1,4})\.(\d{1,4})", version)
    if not parsed:
        raise InputError(where, f"attribute format_version is {_shown(attrs, 'format_version')}", f"{FORMAT_VERSION!r}")
    if int(parsed[1]) > 1:
        raise InputError(
            where,
            f"written by schema {version}, this robustlab reads <= 1.x; upgrade",
            None,
            "pip install --upgrade robustlab",
        )
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
    if no_verify:
        matches = _matches(tree, stored)
        return (
            []
            if matches
            else ["content_sha256 does not match; loaded all the same (--no-verify): certify nothing with it"]
        )
    if not _matches(tree, stored):
        raise InputError(
            tree.file,
            "/: checksum mismatch (content_sha256): the content was changed after it was written",
            None,
            "make the file again, or look at it with --no-verify",
        )
    return []


def _matches(tree: Tree, stored: str) -> bool:
    try:
        return content_sha256(tree) == stored
    except InputError:
        return False  # a dataset of a type that format 1 never writes


def _shown(attrs: dict[str, Any], name: str) -> str:
    if name not in attrs:
        return "missing"
    text = text_attr(attrs, name)
    return repr(text[:40]) if text is not None else "no text"
