"""How a tree, a document or an error goes to another process: a JSON header, then the tree's arrays. No pickle."""

from __future__ import annotations

import json
import math
from datetime import date, datetime, time
from typing import TYPE_CHECKING, Any, BinaryIO

from robustlab.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from robustlab.files.tree import Tree

# A document of JSON or TOML needs no arrays, and its reader no numpy: that one is loaded where trees are sent.

MAGIC = b"RLTREE1\n"
DTYPES = {"f": "<f8", "i": "<i8", "b": "|b1", "c": "<c16"}


def send_tree(stream: BinaryIO, tree: Tree) -> None:
    """Write ``tree`` to ``stream``."""
    arrays: list[np.ndarray[Any, Any]] = []
    _header(stream, {"tree": _node(tree, arrays)})
    for array in arrays:
        stream.write(array.tobytes())
    stream.flush()


def send_document(stream: BinaryIO, data: Any) -> None:
    """Write a document, as `robustlab.files.document.parse_document` gives it, to ``stream``; it is used up by this."""
    _header(stream, _packed(data))
    stream.flush()


def send_error(stream: BinaryIO, error: InputError) -> None:
    """Write an error to ``stream`` in the place of a tree."""
    _header(stream, {"error": [error.where, error.found, error.expected, error.hint, list(error.more)]})
    stream.flush()


def receive(data: bytes, file: str) -> Tree:
    """Inverse of `send_tree` and `send_error`.

    Raises InputError: the error that was sent; ValueError: the bytes are not what the two functions above write.
    """
    header, end = _header_of(data)
    return _Received(memoryview(data)[end:], file).tree(header["tree"], "/")


def receive_document(data: bytes) -> Any:
    """Inverse of `send_document` and `send_error`; raises as `receive`."""
    return _unpacked(_header_of(data)[0])


def _header_of(data: bytes) -> tuple[dict[str, Any], int]:
    """The JSON header and where it ends. Raises InputError: the error that was sent; ValueError: there is no header."""
    start = len(MAGIC) + 8
    if not data.startswith(MAGIC) or len(data) < start:
        raise ValueError("no header")
    end = start + int.from_bytes(data[len(MAGIC) : start], "little")
    header = json.loads(data[start:end])
    if "error" in header:
        where, found, expected, hint, more = header["error"]
        raise InputError(where, found, expected, hint, tuple(more))
    return header, end


def _packed(data: Any) -> dict[str, Any]:
    """The document as JSON types: dates and times, which only TOML has, stand beside it with their places."""
    root, times = [data], []
    pending: list[tuple[Any, list[str | int]]] = [(root, [])]
    while pending:
        node, path = pending.pop()
        for key, value in list(node.items() if isinstance(node, dict) else enumerate(node)):
            if isinstance(value, (dict, list)):
                pending.append((value, [*path, key]))
            elif isinstance(value, (date, time)):
                times.append([[*path, key], type(value).__name__, value.isoformat()])
                node[key] = None
    return {"document": root[0], "times": times}


def _unpacked(content: dict[str, Any]) -> Any:
    """Inverse of `_packed`."""
    root = [content["document"]]
    for path, name, text in content["times"]:
        node: Any = root
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = {"date": date, "time": time, "datetime": datetime}[name].fromisoformat(text)
    return root[0]


def _header(stream: BinaryIO, content: dict[str, Any]) -> None:
    raw = json.dumps(content).encode()
    stream.write(MAGIC + len(raw).to_bytes(8, "little") + raw)


def _node(tree: Tree, arrays: list[np.ndarray[Any, Any]]) -> dict[str, Any]:
    return {
        "attrs": {name: _value(value, arrays) for name, value in tree.attrs.items()},
        "datasets": {
            name: [_value(d.values, arrays), {key: _value(item, arrays) for key, item in d.attrs.items()}]
            for name, d in tree.datasets.items()
        },
        "groups": {name: _node(group, arrays) for name, group in tree.groups.items()},
    }


def _value(value: Any, arrays: list[np.ndarray[Any, Any]]) -> list[Any]:
    from robustlab.files.tree import Unread

    if isinstance(value, Unread):
        return ["unread", value.dtype, list(value.shape)]
    if value.dtype.kind == "U":
        return ["text", value.ravel().tolist(), list(value.shape)]
    array = value.astype(DTYPES[value.dtype.kind], copy=False)
    arrays.append(array)
    return [DTYPES[value.dtype.kind], None, list(value.shape)]


class _Received:
    """Takes the arrays from the bytes in the order in which they were sent."""

    def __init__(self, data: memoryview, file: str) -> None:
        self.data, self.file, self.position = data, file, 0

    def tree(self, node: dict[str, Any], path: str) -> Tree:
        from robustlab.files.tree import Dataset, Tree

        tree = Tree(path=path, file=self.file)
        tree.attrs = {name: self.value(item) for name, item in node["attrs"].items()}
        for name, (values, attrs) in node["datasets"].items():
            tree.datasets[name] = Dataset(self.value(values), {key: self.value(item) for key, item in attrs.items()})
        for name, group in node["groups"].items():
            tree.groups[name] = self.tree(group, tree.child_path(name))
        return tree

    def value(self, item: list[Any]) -> Any:
        import numpy as np

        from robustlab.files.tree import Unread

        kind, content, shape = item[0], item[1], tuple(int(n) for n in item[2])
        if kind == "unread":
            return Unread(content, shape)
        if kind == "text":
            return np.array(content, dtype=np.str_).reshape(shape)
        if kind not in DTYPES.values():
            raise ValueError(f"unknown type {kind}")
        count = math.prod(shape)
        array = np.frombuffer(self.data, dtype=kind, count=count, offset=self.position) if count else np.zeros(0, kind)
        self.position += array.nbytes
        return array.reshape(shape)
