"""Is a PLY file as long as its header says? Open3D gives the points it did not get to as zeros."""

from __future__ import annotations

from pathlib import Path

from s2r_host.perception.errors import InputError

SIZES = {
    "char": 1, "uchar": 1, "int8": 1, "uint8": 1,
    "short": 2, "ushort": 2, "int16": 2, "uint16": 2,
    "int": 4, "uint": 4, "float": 4, "int32": 4, "uint32": 4, "float32": 4,
    "double": 8, "float64": 8,
}  # fmt: skip
LONGEST_HEADER = 65536
"""More than any camera or mesh tool writes [bytes]."""


def check_whole(path: Path) -> None:
    """Refuse a PLY file that ends before its last point, such as one whose copy was interrupted.

    Files whose points come after another element are left to the reader.

    Raises:
        InputError: No PLY file, a header that does not end or says no x, y and z, or fewer points than it says.
    """
    with path.open("rb") as file:
        begin = file.read(LONGEST_HEADER)
    if begin[:4].split(b"\n")[0].rstrip() != b"ply":
        raise InputError(f"view {path}: not a PLY file; it begins with {begin[:4]!r} instead of b'ply\\n'")
    head, end, _ = begin.partition(b"end_header")
    if not end:
        raise InputError(
            f"view {path}: its PLY header has no 'end_header'; the file is cut off, save it again"
        )
    lines = [line.split() for line in head.decode("ascii", "replace").splitlines() if line.strip()]
    elements = [k for k, words in enumerate(lines) if words[0] == "element"]
    first = lines[elements[0]] if elements else []
    if len(first) != 3 or first[1] != "vertex" or not first[2].isdecimal():
        return
    upto = elements[1] if len(elements) > 1 else len(lines)
    properties = [words[1:] for words in lines[elements[0] + 1 : upto] if words[0] == "property"]
    absent = sorted({"x", "y", "z"} - {words[-1] for words in properties if words})
    if absent:
        raise InputError(
            f"view {path}: its points have no {', '.join(absent)}; a depth view needs x, y and z [m]"
        )
    begins = len(head) + len(end) + (2 if begin[len(head) + len(end) :].startswith(b"\r\n") else 1)
    told, found = int(first[2]), _points_there(path, lines, properties, begins)
    if found is not None and found < told:
        raise InputError(
            f"view {path}: {found} of the {told} points that its header tells of are there; "
            "the file is cut off, save or copy it again"
        )


def _points_there(path: Path, lines: list[list[str]], properties: list[list[str]], begins: int) -> int | None:
    """How many points the file has room for after its header; None where lists make that unknown."""
    if ["format", "ascii", "1.0"] in lines:
        with path.open("rb") as file:
            file.seek(begins)
            return sum(bool(line.strip()) for line in file)
    if any(words[0] not in SIZES for words in properties):
        return None
    return (path.stat().st_size - begins) // sum(SIZES[words[0]] for words in properties)
