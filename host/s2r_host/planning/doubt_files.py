"""The doubt about an object from what found its numbers: the model builder's answer and the gap tool's."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco

from s2r_host.errors import HostError
from s2r_host.model.belief import Physics, prior
from s2r_host.perception.intervals import Intervals
from s2r_host.planning.doubt import Doubt, factors
from s2r_host.planning.scene import Scene
from s2r_protocol.exits import UsageError

_SAME = 0.02  # relative difference up to which a number of the scene is that of the patched model
# What the gap tool calls a wrong number or new physics, and where it is in a model.
_NUMBERS = {"damping": "damping", "frictionloss": "joint_friction"}
_EFFECTS = {"viscous_friction": ("coefficient", "damping"), "coulomb_friction": ("level", "joint_friction")}


class DoubtFileError(HostError, UsageError):
    """A file with intervals cannot be used; the text says which and why."""


def doubt_from_estimate(intervals: Intervals, physics: Physics, base: Doubt | None = None) -> Doubt:
    """Doubt about an object built from two views: its joint as the estimate has it, its resistance as guessed.

    Args:
        intervals: 90 % intervals of the estimate.
        physics: What the builder believes about resistance.
        base: What else is in doubt; None: the usual.
    """
    low, high = intervals.delta
    return replace(
        base or Doubt(),
        damping=factors(physics.damping.value, physics.damping.low, physics.damping.high),
        joint_friction=factors(
            physics.frictionloss.value, physics.frictionloss.low, physics.frictionloss.high
        ),
        axis_angle_rad=intervals.axis_angle_rad,
        axis_offset_m=intervals.axis_offset_m,
        along=(high - low) / 2.0,
    )


def doubt_from_files(files: Sequence[Path], scene: Scene, base: Doubt | None = None) -> Doubt:
    """The intervals of ``model.json`` (``s2r build-model``) and ``gap.json`` (``s2r gap``), later files on top.

    Args:
        files: In the order in which they count.
        scene: What is planned in: a file has to speak of its joint.
        base: What is in doubt besides; None: the usual.

    Raises:
        DoubtFileError: A file cannot be read, is neither, or does not fit the scene.
    """
    doubt = base or Doubt()
    for path in files:
        content = _read(path)
        try:
            if "verdict" in content:
                doubt = _with_gap(doubt, content, path, scene)
            elif "intervals90" in content:
                doubt = _with_model(doubt, content, path, scene)
            else:
                raise DoubtFileError(
                    f"{path} holds no intervals: expected gap.json of 's2r gap' or model.json of 's2r build-model'"
                )
        except DoubtFileError:
            raise
        except (KeyError, TypeError, ValueError) as error:
            raise DoubtFileError(f"{path} cannot be used as intervals: {_said(error)}") from error
    return doubt


def _read(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise DoubtFileError(f"file with intervals {path} cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise DoubtFileError(f"file with intervals {path} is not JSON: {error}") from error
    if not isinstance(content, dict):
        raise DoubtFileError(f"file with intervals {path} holds no object but a {type(content).__name__}")
    return content


def _with_model(doubt: Doubt, content: dict[str, Any], path: Path, scene: Scene) -> Doubt:
    kind = content["joint_type"]
    if (kind == "prismatic") != scene.prismatic:
        has = "slide" if scene.prismatic else "hinge"
        raise DoubtFileError(f"{path} is about a {kind} joint; joint {scene.joint!r} of the scene is a {has}")
    found = content["intervals90"]
    low, high = (float(value) for value in found["delta"])
    intervals = Intervals(float(found["axis_angle_rad"]), float(found["axis_offset_m"]), (low, high))
    return doubt_from_estimate(intervals, prior(kind), doubt)


def _with_gap(doubt: Doubt, content: dict[str, Any], path: Path, scene: Scene) -> Doubt:
    """With damping and dry friction of the task's joint within the gap result's intervals.

    The plan should be made with the numbers that the intervals belong to: those of ``model_patched.xml``.
    """
    found: dict[str, tuple[float, float, float]] = {}
    spoken = set()
    for entry in _entries(content, "parameters_off"):
        spoken.add(str(entry.get("joint", entry.get("body"))))
        if entry["name"] in _NUMBERS and entry.get("joint") == scene.joint:
            found[_NUMBERS[entry["name"]]] = (float(entry["to"]), *_ends(entry))
    patched = _patched_numbers(path, scene.joint)
    for entry in _entries(content, "effects"):
        spoken.add(str(entry.get("joint")))
        if entry["name"] in _EFFECTS and entry.get("joint") == scene.joint:
            key, name = _EFFECTS[entry["name"]]
            value, (low, high) = float(entry["parameters"][key]["value"]), _ends(entry["parameters"][key])
            total = patched[name]  # what the effect adds to is in the patched model already
            found[name] = (total, total + low - value, total + high - value)
    if not found:
        about = ", ".join(sorted(spoken)) or "no joint at all"
        raise DoubtFileError(
            f"{path} gives no interval for damping or dry friction of joint {scene.joint!r}; it speaks of {about}"
        )
    in_scene = {
        "damping": float(scene.fine.dof_damping[scene.s_dof]),
        "joint_friction": float(scene.fine.dof_frictionloss[scene.s_dof]),
    }
    spans = {}
    for name, (value, low, high) in found.items():
        if abs(in_scene[name] - value) > _SAME * max(abs(value), 1e-9):
            raise DoubtFileError(
                f"joint {scene.joint!r} of the scene has {name.replace('_', ' ')} {in_scene[name]:g}, {path} found "
                f"{value:g}: plan with that, it is in {path.parent / 'model_patched.xml'}"
            )
        spans[name] = factors(value, low, high)
    return replace(doubt, **spans)


def _entries(content: dict[str, Any], key: str) -> list[dict[str, Any]]:
    entries = content.get(key, [])
    if not isinstance(entries, list) or not all(isinstance(entry, dict) for entry in entries):
        raise TypeError(f"{key} is no list of objects")
    return entries


def _ends(entry: dict[str, Any]) -> tuple[float, float]:
    low, high = entry["interval90"]
    return float(low), float(high)


def _patched_numbers(gap: Path, joint: str) -> dict[str, float]:
    """Damping and dry friction of a joint in the patched model beside a gap result; zero without that model."""
    path = gap.parent / "model_patched.xml"
    if not path.is_file():
        return {"damping": 0.0, "joint_friction": 0.0}
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
        dof = int(model.joint(joint).dofadr[0])
    except (ValueError, KeyError) as error:
        raise DoubtFileError(f"{path} has no joint {joint!r} that can be read: {_said(error)}") from error
    return {"damping": float(model.dof_damping[dof]), "joint_friction": float(model.dof_frictionloss[dof])}


def _said(error: Exception) -> str:
    return f"entry {error} is missing" if isinstance(error, KeyError) else str(error)
