"""The name that an arm has in its cell, without loading its description: a stop must not wait, or fail, for that."""

from __future__ import annotations

from pathlib import Path

from s2r_protocol.exits import UsageError

_SHIPPED = Path(__file__).parents[1] / "arms"


def arm_name(name_or_folder: str) -> str:
    """Of a folder with an ``arm.yaml`` the name in there; anything else is the name already.

    Raises:
        UsageError: The folder has no ``arm.yaml``, or that says no name.
    """
    source = Path(name_or_folder) / "arm.yaml"
    if (_SHIPPED / name_or_folder / "arm.yaml").is_file() and "/" not in name_or_folder:
        return name_or_folder
    if not source.is_file():
        if "/" not in name_or_folder:
            return name_or_folder
        raise UsageError(
            f"--arm {name_or_folder}: there is no {source}; name the folder with the arm's description, or its name; "
            "nothing was sent"
        )
    import yaml  # a name needs none of it

    try:
        said = yaml.safe_load(source.read_text(encoding="utf-8"))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UsageError(
            f"{source} is no YAML ({error}); give --arm the arm's name; nothing was sent"
        ) from error
    name = said.get("name") if isinstance(said, dict) else None
    if not isinstance(name, str):
        raise UsageError(f"{source} says no 'name'; give --arm the arm's name; nothing was sent")
    return name
