"""Type hashes: the ``RIHS01_...`` string that names the exact layout of a ROS 2 message.

REP-2011: SHA-256 over a JSON text of the type description (``type_description_interfaces/msg/TypeDescription``)
with fixed key order, ``", "`` and ``": "`` as separators, nested types sorted by name; constants and defaults left out.
"""

from __future__ import annotations

import functools
import hashlib
import json

from s2r_protocol.ros2.definitions import Field, dependencies, message_type

# type_description_interfaces/msg/FieldType
_NESTED = 1
_TYPE_IDS = {
    "int8": 2,
    "uint8": 3,
    "int16": 4,
    "uint16": 5,
    "int32": 6,
    "uint32": 7,
    "int64": 8,
    "uint64": 9,
    "float32": 10,
    "float64": 11,
    "bool": 15,
    "byte": 16,
    "string": 17,
}
_FIXED_ARRAY, _BOUNDED_SEQUENCE, _UNBOUNDED_SEQUENCE = 48, 96, 144


def _field_description(field: Field) -> dict[str, object]:
    type_id = _NESTED if field.is_nested else _TYPE_IDS[field.base]
    if field.is_array:
        type_id += (
            _FIXED_ARRAY if field.is_fixed else _BOUNDED_SEQUENCE if field.count else _UNBOUNDED_SEQUENCE
        )
    return {
        "name": field.name,
        "type": {
            "type_id": type_id,
            "capacity": field.count,
            "string_capacity": 0,
            "nested_type_name": field.base if field.is_nested else "",
        },
    }


def _type_description(name: str) -> dict[str, object]:
    return {"type_name": name, "fields": [_field_description(f) for f in message_type(name).fields]}


@functools.cache
def type_hash(name: str) -> str:
    """The RIHS01 hash of ``package/msg/Name``, such as ``RIHS01_a13e...``."""
    description = {
        "type_description": _type_description(name),
        "referenced_type_descriptions": [_type_description(n) for n in sorted(dependencies(name))],
    }
    text = json.dumps(description, separators=(", ", ": "), ensure_ascii=True)
    return "RIHS01_" + hashlib.sha256(text.encode("ascii")).hexdigest()
