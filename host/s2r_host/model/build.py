"""From two views and a joint to a physics model on disk."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from s2r_host.model.bar import bar_pieces
from s2r_host.model.belief import Physics, prior
from s2r_host.model.covered import without_covered
from s2r_host.model.drawer import Drawer, drawer_pieces, looks_like_drawer, measure_drawer
from s2r_host.model.errors import ModelError
from s2r_host.model.knob import around_knob, knob_pieces
from s2r_host.model.pieces import Piece
from s2r_host.model.plates import base_pieces, part_pieces
from s2r_host.model.points import ObservedObject, observe
from s2r_host.model.write import write_mjcf, write_urdf
from s2r_host.perception.estimate import JointEstimate
from s2r_host.perception.motion import JointMotion
from s2r_protocol.targets import JointType

logger = logging.getLogger(__name__)

Array = NDArray[np.floating]

SWING_MARGIN_RAD = 1.0


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A built model. Joint value 0 is the pose of the first view.

    Attributes:
        mjcf_path, urdf_path: Files; bodies object_base and object_part, joint object_joint.
        joint_type: "revolute" or "prismatic".
        axis_origin_m, axis_direction: The axis in the frame of the views; the joint grows along this sense.
        s_before, s_after: Joint values of the two views [rad or m].
        range: Joint limits [rad or m].
        physics: Friction, damping, density: value and 90 % interval.
        mass_kg: Of the moving part.
        pieces: The convex pieces, pose of the first view.
        drawer: Measures, if it is one.
        warnings: Sentences for the user.
    """

    mjcf_path: Path
    urdf_path: Path
    joint_type: JointType
    axis_origin_m: Array
    axis_direction: Array
    s_before: float
    s_after: float
    range: tuple[float, float]
    physics: Physics
    mass_kg: float
    pieces: tuple[Piece, ...]
    drawer: Drawer | None
    warnings: tuple[str, ...]


def build_model(
    estimate: JointEstimate,
    out_dir: Path | str,
    *,
    outward: bool = False,
    cpu_limit_s: float = 20.0,
    seed: int = 0,
) -> ObjectModel:
    """Build the model of the object that moved and write ``object.xml`` and ``object.urdf``.

    Args:
        estimate: The joint, with both views.
        out_dir: Folder to write into (made if missing).
        outward: For drawers: let the joint grow out of the cabinet, whatever way it moved between the views.
        cpu_limit_s: Processor time for each convex decomposition.
        seed: Of the sampling.

    Raises:
        ModelError: The views do not show enough.
    """
    rng = np.random.default_rng(seed)
    out = Path(out_dir)
    out.mkdir(parents=True, exist_ok=True)
    seen = observe(estimate, rng)
    drawer: Drawer | None = None
    warnings: list[str] = []
    if looks_like_drawer(estimate, seen):
        drawer = measure_drawer(estimate, seen)
        pieces = drawer_pieces(drawer)
        if outward and drawer.outward_sign < 0:
            estimate = estimate.reversed()
            drawer = replace(drawer, outward_sign=1.0)
        joint_range = _slide_range(drawer, estimate)
        warnings += _drawer_warnings(drawer)
    else:
        known = _known_shape(estimate, seen)
        part, warnings = (known, []) if known is not None else part_pieces(seen, rng, cpu_limit_s)
        bars = [piece for piece in known or [] if piece.name == "bar"]
        sure = bars if estimate.knob is None else around_knob(estimate.knob)
        stayed = without_covered(seen, sure, estimate.motion)
        base, more = base_pieces(stayed, rng, cpu_limit_s)
        pieces, warnings = part + base, warnings + more
        joint_range = _wide_range(estimate)
    if not any(piece.body == "part" for piece in pieces):
        raise ModelError("no piece of the moving part is large enough to model; look closer")
    physics = prior(estimate.joint_type)
    mjcf_path, urdf_path = out / "object.xml", out / "object.urdf"
    # A camera's z leads into the picture; what the object stands on is all that tells where down is then.
    up = seen.up if estimate.up is None else None
    write_mjcf(mjcf_path, pieces, estimate.motion, joint_range, physics, up=up)
    write_urdf(urdf_path, pieces, estimate.motion, joint_range, physics, mjcf_path)
    mass = sum(p.volume_m3 for p in pieces if p.body == "part") * physics.density_kg_m3.value
    logger.info("object model: %d pieces, part %.2f kg, range %.3f to %.3f", len(pieces), mass, *joint_range)
    return ObjectModel(
        mjcf_path, urdf_path, estimate.joint_type, estimate.axis_origin_m, estimate.axis_direction,
        0.0, estimate.delta, joint_range, physics, mass, tuple(pieces), drawer, tuple(warnings),
    )  # fmt: skip


def _known_shape(estimate: JointEstimate, seen: ObservedObject) -> list[Piece] | None:
    """Pieces of a knob or a lever; None for whatever else it is."""
    if estimate.knob is not None:
        return knob_pieces(estimate.knob)
    if estimate.joint_type != "revolute":
        return None
    return bar_pieces(seen, estimate.axis_origin_m, estimate.axis_direction, estimate.lever)


def _slide_range(drawer: Drawer, estimate: JointEstimate) -> tuple[float, float]:
    """Closed where the front meets the cabinet (5 mm margin), open up to most of the body's length."""
    closed = min(-drawer.closing_m - 0.005, estimate.delta * drawer.outward_sign - 0.005)
    opened = max(drawer.depth_m - drawer.closing_m - 0.03, estimate.delta * drawer.outward_sign + 0.05)
    return (closed, opened) if drawer.outward_sign > 0 else (-opened, -closed)


def _wide_range(estimate: JointEstimate) -> tuple[float, float]:
    """The motion seen, with a margin for what was not."""
    low, high = min(0.0, estimate.delta), max(0.0, estimate.delta)
    margin = SWING_MARGIN_RAD if estimate.joint_type == "revolute" else 0.2
    return low - margin, high + margin


def _drawer_warnings(drawer: Drawer) -> list[str]:
    found = []
    if drawer.handle is None:
        found.append("no handle stands out of the drawer front")
    elif not drawer.handle.posts_seen:
        found.append("the handle's posts were not seen; they are put at the ends of the bar")
    if drawer.cabinet_low is None:
        found.append("no cabinet was seen behind the drawer front")
    return found


__all__ = ["JointMotion", "ModelError", "ObjectModel", "ObservedObject", "build_model"]
