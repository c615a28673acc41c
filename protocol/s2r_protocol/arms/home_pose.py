"""Where an arm's links are in a pose and what holding it there takes: enough to see that a description makes sense."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from s2r_protocol.arms.description import ArmDescription
from s2r_protocol.arms.link_pairs import link_pairs
from s2r_protocol.arms.source import FINGER_PREFIX, ArmSource, Box, Joint, Rod


def holding_torques(arm: ArmDescription, q: np.ndarray) -> np.ndarray:
    """Torque that gravity asks of each joint in pose ``q`` (dof,) [rad] at rest: (dof,) [N·m]."""
    model = pin.buildModelFromXML(arm.urdf)
    return pin.computeGeneralizedGravity(model, model.createData(), q)


def lowest_shape(arm: ArmDescription, q: np.ndarray) -> tuple[str, float]:
    """Of the shapes that move, the name of the lowest in pose ``q`` (dof,) [rad] and its height over the base [m]."""
    model = pin.buildModelFromXML(arm.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    heights = {}
    for shape in arm.source.shapes:
        if shape.link in arm.source.standing:
            continue
        link = data.oMf[model.getFrameId(shape.link, pin.FrameType.BODY)]
        heights[shape.name] = _along_z(shape, link, flat=False)[
            0
        ]  # a cylinder's end taken as round: less is lower
    lowest = min(heights, key=heights.__getitem__)
    return lowest, heights[lowest]


def nearest_links(arm: ArmDescription, q: np.ndarray) -> tuple[str, str, float] | None:
    """The two links that are nearest to each other in pose ``q`` (dof,) [rad], and how far apart [m], negative inside.

    None where no pair is to be checked: neighbours and what ``collision_exclude`` names are not.
    """
    model, shapes, pairs = link_pairs(arm)
    if not pairs:
        return None
    found = shapes.createData()
    pin.computeDistances(model, model.createData(), shapes, found, q)
    distances = [result.min_distance for result in found.distanceResults]
    k = int(np.argmin(distances))
    return (*pairs[k], float(distances[k]))


def finger_beyond_tool(arm: ArmDescription) -> float | None:
    """How far the shapes of the finger reach beyond the tool frame along its z axis [m]; None without such shapes."""
    model = pin.buildModelFromXML(arm.urdf)
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.zeros(arm.dof))
    tool = data.oMf[model.getFrameId(arm.tool_frame, pin.FrameType.BODY)]
    ends = []
    for shape in arm.source.shapes:
        if not shape.name.startswith(FINGER_PREFIX):
            continue
        link = tool.actInv(data.oMf[model.getFrameId(shape.link, pin.FrameType.BODY)])
        ends.append(_along_z(shape, link, flat=shape.type == "cylinder")[1])
    return max(ends, default=None)


def _along_z(shape: Rod | Box, link: pin.SE3, flat: bool) -> tuple[float, float]:
    """From where to where a shape of a link in that pose reaches along z [m]; the ends of a rod are flat or round."""
    if isinstance(shape, Box):
        middle, reach = link.act(np.array(shape.center))[2], np.abs(link.rotation[2]) @ np.array(shape.half)
        return float(middle - reach), float(middle + reach)
    a, b = (link.act(np.array(end)) for end in (shape.a, shape.b))
    along = (b - a) / np.linalg.norm(b - a)
    reach = shape.radius * (np.hypot(along[0], along[1]) if flat else 1.0)
    return float(min(a[2], b[2]) - reach), float(max(a[2], b[2]) + reach)


def longest_offset(source: ArmSource) -> tuple[str, float]:
    """The joint, mount or tool that lies farthest from the frame it hangs off, and how far [m]."""
    offsets = {
        c.name if isinstance(c, Joint) else c.child: c.origin for c in (*source.joints, *source.mounts)
    }
    offsets[source.tool.name] = source.tool.origin
    lengths = {name: float(np.linalg.norm(origin)) for name, origin in offsets.items()}
    longest = max(lengths, key=lengths.__getitem__)
    return longest, lengths[longest]
