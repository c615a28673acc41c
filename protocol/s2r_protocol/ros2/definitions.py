"""ROS 2 message definitions: the ``.msg`` texts beside this file, parsed into fields.

Full names are ``package/msg/Name``; the texts use the short ``package/Name`` for nested types.
"""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from importlib import resources

PRIMITIVES = {
    "bool": 1,
    "byte": 1,
    "int8": 1,
    "uint8": 1,
    "int16": 2,
    "uint16": 2,
    "int32": 4,
    "uint32": 4,
    "int64": 8,
    "uint64": 8,
    "float32": 4,
    "float64": 8,
}
"""Name of each primitive type and its size in bytes."""

_FIELD = re.compile(
    r"(?P<base>[A-Za-z][A-Za-z0-9_/]*)(?P<array>\[(?P<bounded><=)?(?P<count>\d+)?\])?\s+"
    r"(?P<name>[A-Za-z][A-Za-z0-9_]*)\s*(?P<constant>=\s*(?P<value>\S+))?"
)
_SEPARATOR = "=" * 80


class UnknownMessageTypeError(KeyError):
    """No definition of that name is shipped."""


@dataclass(frozen=True)
class Field:
    """One field of a message.

    Attributes:
        name: As in the text.
        base: Primitive, ``string`` or the full name of a nested message.
        is_array: Fixed array or sequence.
        count: Length of a fixed array, largest length of a bounded sequence, 0 for an unbounded one.
        is_fixed: True for a fixed array.
    """

    name: str
    base: str
    is_array: bool = False
    count: int = 0
    is_fixed: bool = False

    @property
    def is_nested(self) -> bool:
        """Whether the element is a message of its own."""
        return "/" in self.base


@dataclass(frozen=True)
class MessageType:
    """A parsed message definition."""

    name: str
    fields: tuple[Field, ...]
    constants: tuple[tuple[str, str, int], ...]  # (type, name, value)
    text: str

    @property
    def short_name(self) -> str:
        """``package/Name``."""
        package, _, name = self.name.split("/")
        return f"{package}/{name}"

    @property
    def dds_name(self) -> str:
        """The name DDS and rmw_zenoh use: ``package::msg::dds_::Name_``."""
        package, _, name = self.name.split("/")
        return f"{package}::msg::dds_::{name}_"


def _full_name(short: str) -> str:
    package, *_, name = short.split("/")
    return f"{package}/msg/{name}"


def parse(name: str, text: str) -> MessageType:
    """Parse one definition text.

    Raises:
        ValueError: A line is not a field, constant or comment of the subset used here.
    """
    fields: list[Field] = []
    constants: list[tuple[str, str, int]] = []
    for number, raw in enumerate(text.splitlines(), start=1):
        line = raw.split("#", 1)[0].strip()
        if not line:
            continue
        match = _FIELD.match(line)
        if match is None:
            raise ValueError(f"{name}, line {number}: cannot read {raw!r} as a field")
        base = match["base"]
        if base not in PRIMITIVES and base != "string":
            if "/" not in base:
                raise ValueError(f"{name}, line {number}: nested type {base!r} must be written package/Name")
            base = _full_name(base)
        if match["constant"]:
            constants.append((base, match["name"], int(match["value"])))
            continue
        count = int(match["count"] or 0)
        is_array = match["array"] is not None
        fields.append(
            Field(
                match["name"], base, is_array, count, is_fixed=is_array and count > 0 and not match["bounded"]
            )
        )
    return MessageType(name, tuple(fields), tuple(constants), text)


@functools.cache
def message_type(name: str) -> MessageType:
    """The definition of ``package/msg/Name``.

    Raises:
        UnknownMessageTypeError: It is not shipped.
    """
    package, _, short = name.split("/")
    path = resources.files("s2r_protocol.ros2") / "msg" / package / f"{short}.msg"
    if not path.is_file():
        raise UnknownMessageTypeError(
            f"no definition of {name} is shipped; there are {', '.join(all_names())}"
        )
    return parse(name, path.read_text(encoding="utf-8"))


@functools.cache
def all_names() -> tuple[str, ...]:
    """Full names of all shipped definitions, sorted."""
    root = resources.files("s2r_protocol.ros2") / "msg"
    return tuple(
        sorted(
            f"{package.name}/msg/{file.name.removesuffix('.msg')}"
            for package in root.iterdir()
            if package.is_dir()
            for file in package.iterdir()
            if file.name.endswith(".msg")
        )
    )


@functools.cache
def dependencies(name: str) -> tuple[str, ...]:
    """Full names of all nested types, directly or not, each once, in order of first use."""
    found: dict[str, None] = {}
    for field in message_type(name).fields:
        if field.is_nested:
            found.setdefault(field.base)
            for deeper in dependencies(field.base):
                found.setdefault(deeper)
    return tuple(found)


@functools.cache
def schema_text(name: str) -> str:
    """Definition with all nested ones appended, as MCAP's ``ros2msg`` schema encoding wants it."""
    parts = [message_type(name).text.rstrip("\n") + "\n"]
    for nested in dependencies(name):
        definition = message_type(nested)
        parts.append(f"{_SEPARATOR}\nMSG: {definition.short_name}\n{definition.text.rstrip()}\n")
    return "".join(parts)
