"""Pack and unpack ROS 2 messages as CDR, driven by their definitions.

Encoding: XCDR version 1, little endian (OMG DDSI-RTPS 2.5, 10.2), the one every ROS 2 middleware speaks:
a 4-byte header ``00 01 00 00``, then the fields, each aligned to its own size counted from after the header.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from s2r_protocol.ros2.definitions import PRIMITIVES, Field, message_type

HEADER = b"\x00\x01\x00\x00"

_DTYPES = {
    "bool": np.dtype("?"),
    "byte": np.dtype("u1"),
    "int8": np.dtype("i1"),
    "uint8": np.dtype("u1"),
    "int16": np.dtype("<i2"),
    "uint16": np.dtype("<u2"),
    "int32": np.dtype("<i4"),
    "uint32": np.dtype("<u4"),
    "int64": np.dtype("<i8"),
    "uint64": np.dtype("<u8"),
    "float32": np.dtype("<f4"),
    "float64": np.dtype("<f8"),
}
_STRUCTS = {
    name: struct.Struct("<" + code)
    for name, code in zip(
        (
            "bool",
            "byte",
            "int8",
            "uint8",
            "int16",
            "uint16",
            "int32",
            "uint32",
            "int64",
            "uint64",
            "float32",
            "float64",
        ),
        "?BbBhHiIqQfd",
        strict=True,
    )
}

Values = Mapping[str, Any]  # field name -> number, str, sequence, array or nested mapping


class CdrError(ValueError):
    """Values that do not fit the definition, or bytes that are not a message of this type."""


def pack(name: str, values: Values) -> bytes:
    """Pack a message.

    Args:
        name: Full type name, ``package/msg/Name``.
        values: Field name -> value; missing fields are zero, empty or, for messages, recursively so.

    Raises:
        CdrError: A field is unknown, of the wrong length or out of its type's range.
    """
    out = bytearray()
    _write_message(out, name, values)
    return HEADER + bytes(out)


def unpack(name: str, wire: bytes) -> dict[str, Any]:
    """Unpack a message; numeric arrays come back as numpy arrays.

    Raises:
        CdrError: The bytes are too short, use another encoding or hold an impossible length.
    """
    if wire[:4] != HEADER:
        raise CdrError(f"{name}: encapsulation header is {wire[:4].hex()}, expected {HEADER.hex()}")
    reader = _Reader(name, memoryview(wire)[4:])
    return reader.message(name)


def _align(out: bytearray, size: int) -> None:
    out.extend(bytes(-len(out) % size))


def _write_message(out: bytearray, name: str, values: Values) -> None:
    fields = message_type(name).fields
    if len(values) > len(fields) or any(key not in {f.name for f in fields} for key in values):
        unknown = sorted(set(values) - {f.name for f in fields})
        raise CdrError(
            f"{name} has no field {', '.join(unknown)}; it has {', '.join(f.name for f in fields)}"
        )
    for field in fields:
        value = values.get(field.name)
        try:
            _write_field(out, field, value)
        except (struct.error, TypeError, OverflowError) as error:
            raise CdrError(f"{name}.{field.name}: cannot pack {value!r} as {field.base}: {error}") from error


def _write_field(out: bytearray, field: Field, value: Any) -> None:  # a number, text, sequence or mapping
    if not field.is_array:
        _write_element(out, field.base, value)
        return
    items = _as_items(field, value)
    if not field.is_fixed:
        _align(out, 4)
        out.extend(struct.pack("<I", len(items)))
    if field.base in PRIMITIVES:
        if len(items):
            _align(out, PRIMITIVES[field.base])
            out.extend(np.ascontiguousarray(items, dtype=_DTYPES[field.base]).tobytes())
        return
    for item in items:
        _write_element(out, field.base, item)


def _as_items(field: Field, value: Any) -> Sequence[Any] | np.ndarray:
    items = value if value is not None else ([0] * field.count if field.is_fixed else [])
    if isinstance(items, (bytes, bytearray, memoryview)):
        items = np.frombuffer(items, dtype=np.uint8)
    if field.is_fixed and len(items) != field.count:
        raise CdrError(f"{field.name} must hold {field.count} values, got {len(items)}")
    if field.count and len(items) > field.count:
        raise CdrError(f"{field.name} may hold at most {field.count} values, got {len(items)}")
    return items


def _write_element(out: bytearray, base: str, value: Any) -> None:
    if base == "string":
        text = (value or "").encode("utf-8") + b"\0"
        _align(out, 4)
        out.extend(struct.pack("<I", len(text)))
        out.extend(text)
    elif base in PRIMITIVES:
        _align(out, PRIMITIVES[base])
        out.extend(_STRUCTS[base].pack(value or 0))
    else:
        _write_message(out, base, value or {})


class _Reader:
    """A cursor over the bytes after the encapsulation header."""

    def __init__(self, name: str, data: memoryview) -> None:
        self.name = name
        self.data = data
        self.at = 0

    def take(self, count: int, align: int = 1) -> memoryview:
        start = self.at + (-self.at % align)
        if start + count > len(self.data):
            raise CdrError(f"{self.name}: needs {start + count} bytes, there are {len(self.data)}")
        self.at = start + count
        return self.data[start : self.at]

    def length(self) -> int:
        return struct.unpack("<I", self.take(4, 4))[0]

    def message(self, name: str) -> dict[str, Any]:
        return {field.name: self.field(field) for field in message_type(name).fields}

    def field(self, field: Field) -> Any:
        if not field.is_array:
            return self.element(field.base)
        count = field.count if field.is_fixed else self.length()
        if field.base in PRIMITIVES:
            size = PRIMITIVES[field.base]
            block = self.take(count * size, size) if count else b""
            return np.frombuffer(block, dtype=_DTYPES[field.base])
        if count > len(self.data):  # each element takes at least one byte: refuse before looping
            raise CdrError(
                f"{self.name}.{field.name}: {count} elements do not fit into {len(self.data)} bytes"
            )
        return [self.element(field.base) for _ in range(count)]

    def element(self, base: str) -> Any:
        if base == "string":
            raw = bytes(self.take(self.length()))
            if not raw.endswith(b"\0"):
                raise CdrError(f"{self.name}: a string does not end with a zero byte")
            try:
                return raw[:-1].decode("utf-8")
            except UnicodeDecodeError as error:
                raise CdrError(f"{self.name}: a string is not UTF-8: {error}") from error
        if base in PRIMITIVES:
            return _STRUCTS[base].unpack(self.take(PRIMITIVES[base], PRIMITIVES[base]))[0]
        return self.message(base)
