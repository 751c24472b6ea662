"""Values as bytes and back, bit by bit, without pickle.

A packed value is a checksum, a JSON tree, and the bytes of its arrays one after the other. Value
types are packed field by field, so a field that is added to one of them needs no change here.
"""

import dataclasses
import json
import math
import struct
import zlib
from collections.abc import Mapping
from typing import Any

import numpy as np

__all__ = ["PackingError", "layout", "pack", "unpack"]

_HEAD = struct.Struct("<II")  # checksum of everything behind it; bytes of the tree
_KIND, _ARRAY, _TUPLE, _MAPPING = "kind", "array", "tuple", "mapping"
_PLAIN = (str, int, float, bool, type(None))
_NUMBERS = "biuf"  # kinds of numpy types whose bytes are their value
Types = Mapping[str, type]


class PackingError(Exception):
    """The bytes are damaged, or hold types that are not known."""


def layout(types: Types) -> dict[str, list[str]]:
    """Return the names of the fields of each type: what is packed under another differs."""
    return {name: [item.name for item in dataclasses.fields(kind)] for name, kind in types.items()}


def pack(value: object, types: Types) -> bytes:
    """Return `value` as bytes.

    Parameters
    ----------
    value
        A number, text, None, numpy array, tuple or mapping with text keys, or one of `types`, of
        any depth.
    types
        Names of the dataclasses that may occur.

    Raises
    ------
    TypeError
        If something else occurs.
    """
    arrays: list[bytes] = []
    tree = json.dumps(_tree(value, types, arrays), separators=(",", ":")).encode()
    body = b"".join([tree, *arrays])
    return _HEAD.pack(zlib.crc32(body), len(tree)) + body


def _tree(value: object, types: Types, arrays: list[bytes]) -> object:
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, _PLAIN):
        return value
    if isinstance(value, np.ndarray) and value.dtype.kind in _NUMBERS:
        arrays.append(value.tobytes())
        return {_KIND: _ARRAY, "dtype": value.dtype.str, "shape": list(value.shape)}
    if isinstance(value, tuple):
        return {_KIND: _TUPLE, "items": [_tree(item, types, arrays) for item in value]}
    if isinstance(value, Mapping) and all(isinstance(key, str) for key in value):
        items = {key: _tree(item, types, arrays) for key, item in value.items()}
        return {_KIND: _MAPPING, "items": items}
    name = type(value).__name__
    if types.get(name) is not type(value):
        raise TypeError(f"{name} cannot be packed")
    fields = dataclasses.fields(value)  # type: ignore[arg-type]  # all of `types` are dataclasses
    items = {item.name: _tree(getattr(value, item.name), types, arrays) for item in fields}
    return {_KIND: name, "items": items}


def unpack(content: bytes, types: Types) -> object:
    """Return the value that `pack` made into bytes.

    Raises
    ------
    PackingError
        If the bytes are damaged or hold other types.
    """
    try:
        checksum, length = _HEAD.unpack_from(content)
        body = memoryview(content)[_HEAD.size :]
        if zlib.crc32(body) != checksum:
            raise PackingError("the checksum is wrong")
        tree = json.loads(bytes(body[:length]))
        return _Reader(body[length:], types).value(tree)
    except (struct.error, ValueError, TypeError, KeyError, RecursionError) as error:
        raise PackingError(str(error)) from error


class _Reader:
    """Takes arrays from the bytes in the order in which they were packed."""

    def __init__(self, content: memoryview, types: Types) -> None:
        self._content = content
        self._types = types

    def value(self, tree: Any) -> object:  # noqa: ANN401 (what JSON gives)
        if not isinstance(tree, dict):
            return tree
        kind = tree[_KIND]
        if kind == _ARRAY:
            return self._array(np.dtype(tree["dtype"]), tree["shape"])
        if kind == _TUPLE:
            return tuple(self.value(item) for item in tree["items"])
        items = {key: self.value(item) for key, item in tree["items"].items()}
        return items if kind == _MAPPING else self._types[kind](**items)

    def _array(self, dtype: np.dtype[Any], shape: list[int]) -> np.ndarray[Any, Any]:
        size = dtype.itemsize * math.prod(shape)
        taken, self._content = self._content[:size], self._content[size:]
        return np.frombuffer(taken, dtype).reshape(shape).copy()  # a view would be read-only
