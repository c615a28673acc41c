"""YAML files that the user names: their content, or a refusal that says what to do."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from s2r_host.gap.errors import GapUsageError


def read_yaml(path: Path, what: str, next_step: str) -> Any:
    """Content of a YAML or JSON file; ``Any``, since it is checked by whoever knows its keys.

    Args:
        path: The file.
        what: What it is, for the refusal.
        next_step: What to do where there is no such file.

    Raises:
        GapUsageError: Not there, not readable, or no YAML.
    """
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise GapUsageError(f"{what} '{path}': {error.strerror}; {next_step}") from error
    except (ValueError, yaml.YAMLError) as error:  # ValueError: no UTF-8, or a date that there is not
        raise GapUsageError(f"{what} '{path}' is no YAML: {str(error).splitlines()[0]}") from error
