"""An arm description as the text of an ``arm.yaml``, one line per link, joint and shape."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import yaml

from s2r_protocol.arms.source import ArmSource

_HEAD = """\
# Written by 's2r import-arm' from {urdf}. From here on this file is the one source of the arm: edit it.
# Lengths m, masses kg, inertias kg m2, angles rad, torques N m. All frames are parallel to the base's at zero.
"""


def to_yaml(source: ArmSource, urdf: str, told: Sequence[str]) -> str:
    """The text, with what was decided or left out as comments."""
    raw = source.model_dump(mode="json")
    for link in raw["links"]:
        if not any(link["products"]):
            del link["products"]
    rows = [_HEAD.format(urdf=urdf)]
    rows += [f"# - {line}" for line in told]
    rows += [f"{key}: {_flow(raw[key])}" for key in ("name", "vendor", "base")]
    limits = "\n# ddq_max and dddq_max are not in a URDF: look them up."
    for key, remark in (("links", ""), ("joints", limits), ("mounts", ""), ("shapes", "")):
        if raw[key]:
            rows += [f"{remark}\n{key}:", *(f"  - {_flow(entry)}" for entry in raw[key])]
        if key == "mounts":
            rows.append(f"\ntool: {_flow(raw['tool'])}")
    if raw["collision_exclude"]:
        rows += ["\ncollision_exclude:", *(f"  - {_flow(pair)}" for pair in raw["collision_exclude"])]
    rows.append(f"\nq_home: {_flow(raw['q_home'])}")
    return "\n".join(rows) + "\n"


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True)
    return text.removesuffix("...\n").strip()
