"""Read an untrusted HDF5 file into a `Tree`.

Runs in a child process; see `robustlab.files.isolation`. Links are checked before they are followed, types and declared
sizes before values are read.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from h5py import h5a, h5d, h5g, h5l, h5o, h5t, h5z  # pyright: ignore[reportAttributeAccessIssue]

from robustlab.arrays import AnyArray
from robustlab.errors import InputError
from robustlab.files.file_types import Limits, size_text
from robustlab.files.tree import Dataset, Tree, Unread, canonical

# Filters built into HDF5 or h5py: deflate, shuffle, fletcher32, nbit, scaleoffset, lzf; no plugin is loaded.
KNOWN_FILTERS = (1, 2, 3, 5, 6, 32000)
# Deflate compresses by 1032 at most; a larger factor means a hostile file.
MAX_EXPANSION = 2000
MAX_ATTRIBUTE = 1 << 20
MAX_PROBLEMS = 20
MAX_TEXTS = 100_000
DAMAGED = "copy or export the file again; if it was made by robustlab, run the command that made it again"
HINTS = {  # word in a problem -> hint
    "plugins": "h5repack -f GZIP=6 IN OUT writes it with a filter that everyone has",
    "checksum": DAMAGED,
    "damaged": DAMAGED,
}


@dataclass
class _Walk:
    """The state of reading: the limits, the amount read, and all problems."""

    file: str
    limits: Limits
    wanted: str | None
    total: int = 0
    objects: int = 0
    groups_seen: set[Any] = field(default_factory=set)
    problems: list[str] = field(default_factory=list)

    def problem(self, path: str, text: str) -> None:
        self.problems.append(f"{path}: {text}")


def read_hdf5(path: str, limits: Limits, group: str | None = None, shown: str | None = None) -> Tree:
    """Read ``path`` into a tree; everything is checked, values are read of ``group`` only."""
    where = shown or path
    try:
        file = h5py.File(path, "r", locking=False)
    except OSError as error:
        found = f"damaged or truncated HDF5 file of {Path(path).stat().st_size} bytes ({_short(error)})"
        cut = re.search(r"truncated file: eof = (\d+), sblock->base_addr = (\d+), stored_eof = (\d+)", str(error))
        if cut:
            eof, base, stored = (int(n) for n in cut.groups())
            found = f"truncated: {eof} of {base + stored} bytes"
        raise InputError(where, found, None, DAMAGED) from None
    walk = _Walk(where, limits, group.strip("/") if group else None)
    try:
        with file:
            tree = _group(walk, h5g.open(file.id, b"/"), "/", 0)
    except MemoryError:
        raise InputError(where, "needs more memory than the reader may use", None, DAMAGED) from None
    except Exception as error:  # any error of the library means a damaged file
        raise InputError(
            where, f"damaged HDF5 file ({type(error).__name__}: {_short(error)})", None, DAMAGED
        ) from error
    if walk.problems:
        lines = [f"{where}: {line}" for line in walk.problems[:MAX_PROBLEMS]]
        if len(walk.problems) > MAX_PROBLEMS:
            lines.append(f"{where}: ... and {len(walk.problems) - MAX_PROBLEMS} more")
        place, _, found = walk.problems[0].partition(": ")
        hint = next((text for word, text in HINTS.items() if word in walk.problems[0]), None)
        raise InputError(f"{where}: {place}", found, None, hint, tuple(lines[1:]))
    return tree


def _short(error: BaseException) -> str:
    text = str(error)
    inner = re.search(r"\((.*)\)", text)
    return (inner.group(1) if inner else text)[:120] or type(error).__name__


def _group(walk: _Walk, gid: h5g.GroupID, path: str, depth: int) -> Tree:
    tree = Tree(path=path, file=walk.file)
    info = h5o.get_info(gid)
    if (info.fileno, info.addr) in walk.groups_seen:
        walk.problem(path, "group is linked twice (a loop of hard links)")
        return tree
    walk.groups_seen.add((info.fileno, info.addr))
    if depth > walk.limits.depth:
        walk.problem(path, f"groups are nested deeper than {walk.limits.depth}")
        return tree
    tree.attrs = _attributes(walk, gid, path)
    if gid.get_num_objs() > walk.limits.objects:
        walk.problem(path, f"{gid.get_num_objs()} objects in one group, limit {walk.limits.objects}")
        return tree
    for raw in sorted(gid):
        _link(walk, gid, raw, tree, depth)
        if walk.objects > walk.limits.objects:
            walk.problem(path, f"more than {walk.limits.objects} objects in the file")
            break
        if len(walk.problems) > 4 * MAX_PROBLEMS:
            break
    return tree


def _link(walk: _Walk, gid: h5g.GroupID, raw: bytes, tree: Tree, depth: int) -> None:
    """Follow a hard link; report every other kind, which may leave the file."""
    walk.objects += 1
    try:
        name = raw.decode()
    except UnicodeDecodeError:
        walk.problem(tree.path, f"name {raw[:40]!r} is not UTF-8")
        return
    path = tree.child_path(name)
    if len(name) > walk.limits.name:
        walk.problem(tree.child_path(name[:40] + "..."), f"name of {len(name)} characters, limit {walk.limits.name}")
        return
    kind = gid.links.get_info(raw).type
    if kind == h5l.TYPE_HARD:
        child = h5o.open(gid, raw)
        if isinstance(child, h5g.GroupID):
            tree.groups[name] = _group(walk, child, path, depth + 1)
        elif isinstance(child, h5d.DatasetID):
            tree.datasets[name] = _dataset(walk, child, path)
        return
    target = gid.links.get_val(raw) if kind in (h5l.TYPE_SOFT, h5l.TYPE_EXTERNAL) else ()
    words = {h5l.TYPE_SOFT: "soft link to", h5l.TYPE_EXTERNAL: "external link to"}.get(kind, "user-defined link")
    parts = [target] if isinstance(target, bytes) else target
    walk.problem(path, " ".join([words, *map(_target, parts), "is not allowed"]))


def _target(raw: bytes) -> str:
    return repr(raw.decode("utf-8", "backslashreplace"))


def _dataset(walk: _Walk, did: h5d.DatasetID, path: str) -> Dataset:
    plist = did.get_create_plist()
    if plist.get_layout() == h5d.VIRTUAL:
        walk.problem(path, "virtual dataset (its values lie in other files) is not allowed")
        return Dataset(Unread("virtual", ()))
    if plist.get_external_count():
        walk.problem(path, f"external storage {_target(plist.get_external(0)[0])} is not allowed")
        return Dataset(Unread("external", ()))
    attrs = _attributes(walk, did, path)
    shape, kind = did.shape, _kind(did.get_type())
    if shape is None:
        return Dataset(Unread("no values (null dataspace)", ()), attrs)
    # A dataset is wanted below the group, and in the root itself.
    wanted = walk.wanted is None or path.startswith(f"/{walk.wanted}/") or path.count("/") == 1
    if kind not in READ or not wanted:
        return Dataset(Unread("not read" if kind in ("number", "text") else kind, shape), attrs)
    if not _may_be_read(walk, did, plist, path, kind):
        return Dataset(Unread("too large", shape), attrs)
    if kind == "text" and math.prod(shape) > MAX_TEXTS:
        walk.problem(path, f"{math.prod(shape)} texts, limit {MAX_TEXTS}")
        return Dataset(Unread("text", shape), attrs)
    dataset = h5py.Dataset(did)
    try:
        return Dataset(_plain(dataset[()], kind), attrs)
    except UnicodeError:
        walk.problem(path, "text is not UTF-8")
    except InputError as error:
        walk.problem(path, error.found)
    except (OSError, RuntimeError) as error:
        # the checksum is the first filter when reading
        summed = dataset.fletcher32 and "filter" in str(error)
        walk.problem(path, "checksum mismatch" if summed else f"damaged values ({_short(error)})")
    return Dataset(Unread("damaged", shape), attrs)


def _may_be_read(walk: _Walk, did: h5d.DatasetID, plist: Any, path: str, kind: str) -> bool:
    """Check filters, declared size in memory (8 bytes a number), and stored against declared size."""
    for i in range(plist.get_nfilters()):
        code, _, _, label = plist.get_filter(i)
        if code not in KNOWN_FILTERS or not h5z.filter_avail(code):
            word = f" ({label.decode(errors='replace')})" if label else ""
            walk.problem(path, f"filter {code}{word} is not known here; plugins are not loaded")
            return False
    shape, limit, stated = did.shape, walk.limits.dataset, did.get_type().get_size()
    declared = math.prod(shape) * {"number": 8, "complex": 16, "text": 4 * stated}.get(kind, stated)
    chunk = math.prod(plist.get_chunk()) * stated if plist.get_layout() == h5d.CHUNKED else 0
    stored, size = did.get_storage_size(), " x ".join(str(n) for n in shape)
    total = walk.total + declared
    grown = f"declares {size_text(declared)} in {stored} stored bytes: made to grow when it is read"
    whole = f"with this dataset {size_text(total)} in all, limit {size_text(walk.limits.total)}"
    for too_much, text in (
        (declared > limit, f"declares {size} ({size_text(declared)}), limit {size_text(limit)}"),
        (chunk > limit, f"chunks of {size_text(chunk)} in memory, limit {size_text(limit)}"),
        (declared and not stored, f"declares {size or 'a number'}, but no values are stored"),
        (declared > max(limit // 64, MAX_EXPANSION * stored), grown),
        (total > walk.limits.total, whole),
    ):
        if too_much:
            walk.problem(path, text)
            return False
    walk.total = total
    return True


READ = ("number", "bool", "complex", "text")
TYPES = {
    h5t.STRING: "text", h5t.OPAQUE: "opaque", h5t.REFERENCE: "reference", h5t.VLEN: "variable length",
    h5t.ARRAY: "array", h5t.BITFIELD: "bitfield", h5t.TIME: "time",
}  # fmt: skip
SIZES = {h5t.INTEGER: (1, 2, 4, 8), h5t.FLOAT: (4, 8)}  # bytes of a number that is read


def _kind(tid: Any) -> str:
    """Return ``number``, ``bool``, ``complex``, ``text``, or the name of a type that is not read."""
    code, size = tid.get_class(), tid.get_size()
    if code in TYPES:
        return TYPES[code]
    if code in SIZES:
        return "number" if size in SIZES[code] else f"{'int' if code == h5t.INTEGER else 'float'}{8 * size}"
    try:
        dtype = tid.dtype
    except TypeError:
        return "unknown type"
    if dtype.kind == "b" or dtype.str[1:] in ("c8", "c16"):
        return "bool" if dtype.kind == "b" else "complex"
    names = dtype.names or ()
    if code == h5t.COMPOUND and names:
        return "complex128" if names == ("real", "imag") else f"compound ({', '.join(names[:4])})"
    return "enumeration" if code == h5t.ENUM else str(dtype)


def _plain(values: Any, kind: str) -> AnyArray:
    """Return values as float64, int64, bool, complex128 or text arrays of the same shape."""
    array = np.asarray(values)
    if kind == "text":
        # h5py decodes invalid UTF-8 to lone surrogates, which cannot be encoded.
        raw = [item if isinstance(item, bytes) else str(item).encode() for item in array.ravel().tolist()]
        flat = [item.decode() for item in raw]
        width = max((len(text) for text in flat), default=1)
        return np.array(flat, dtype=f"U{max(width, 1)}").reshape(array.shape)
    return canonical(array, kind)


def _attributes(walk: _Walk, oid: Any, path: str) -> dict[str, Any]:
    """Return the attributes of types that are read; others, such as references of a dimension scale, are ignored."""
    attrs: dict[str, Any] = {}
    values = (h5py.Group(oid) if isinstance(oid, h5g.GroupID) else h5py.Dataset(oid)).attrs
    for i in range(h5a.get_num_attrs(oid)):
        aid = h5a.open(oid, index=i)
        name, kind, shape = aid.name.decode(errors="surrogateescape"), _kind(aid.get_type()), aid.shape
        try:
            name.encode()
            if len(name) > walk.limits.name:
                walk.problem(path, f"attribute name of {len(name)} characters, limit {walk.limits.name}")
            elif kind not in READ or shape is None:
                continue
            elif math.prod(shape) * aid.get_type().get_size() > MAX_ATTRIBUTE:
                walk.problem(path, f"attribute {name} is larger than {size_text(MAX_ATTRIBUTE)}")
            else:
                attrs[name] = _plain(values[name], kind)
        except UnicodeError:
            walk.problem(path, f"attribute {aid.name[:40]!r} is not UTF-8")
        except InputError as error:
            walk.problem(path, f"attribute {name} is {error.found}")
        except (OSError, RuntimeError) as error:
            walk.problem(path, f"attribute {name} is damaged ({_short(error)})")
    return attrs
