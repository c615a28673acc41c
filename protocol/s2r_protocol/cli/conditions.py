"""What the results of a bench were made with, kept beside them: results of other conditions are not mixed with them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from s2r_protocol.exits import UsageError


def conditions_of(results: Path) -> Path:
    """Where the conditions of a file of results are kept."""
    return results.with_suffix(".conditions.json")


def keep_to(conditions: dict[str, Any], results: Path, *, begun: bool) -> None:
    """Note the conditions beside the results, or refuse to go on with others.

    Args:
        conditions: What all results are made with and their names do not say, in JSON.
        results: The file of results; the conditions of ``NAME.jsonl`` are in ``NAME.conditions.json``.
        begun: Whether the file holds a result. Without one nothing can be mixed.

    Raises:
        UsageError: The results were made with others, or nobody knows with which; names the condition, both values
            and what to do.
    """
    path = conditions_of(results)
    if not begun:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(conditions, indent=1) + "\n")
        return
    if not path.is_file():
        raise UsageError(
            f"{results} holds results and no {path.name} that says what they were made with: give another --out"
        )
    before = json.loads(path.read_text())
    for name, value in conditions.items():
        if before.get(name) != value:
            raise UsageError(
                f"{results} holds results with {name} {before.get(name)!r}, not {value!r}: give another --out, or "
                "the same options to go on"
            )
