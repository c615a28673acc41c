"""Where an arm's links are in a pose and what holding it there takes: enough to see that a description makes sense.

Plain sums over one chain; dynamics and collisions are Pinocchio's, in the executor.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from s2r_protocol.arms.source import ArmSource, Box, Joint

_GRAVITY_M_S2 = np.array([0.0, 0.0, -9.81])
_AXES = {"x": np.array([1.0, 0.0, 0.0]), "y": np.array([0.0, 1.0, 0.0]), "z": np.array([0.0, 0.0, 1.0])}


@dataclass(frozen=True, eq=False)
class _Frame:
    """A link's frame in the base: rotation (3, 3) and origin [m], (3,)."""

    R: np.ndarray
    p: np.ndarray

    def at(self, point: tuple[float, float, float]) -> np.ndarray:
        return self.p + self.R @ np.array(point)


def holding_torques(source: ArmSource, q: np.ndarray) -> np.ndarray:
    """Torque that gravity asks of each joint in pose ``q`` (dof,) [rad] at rest: (dof,) [N·m].

    For joint i: −a_i · Σ (c_k − p_i) × m_k g over the links k that it carries.
    """
    frames = _frames(source, q)
    torques = np.zeros(len(source.joints))
    for i, joint in enumerate(source.joints):
        frame = frames[joint.child]
        axis = frame.R @ _AXES[joint.axis]
        for name in _carried(source, joint):
            link = source.link_named(name)
            torques[i] -= axis @ np.cross(frames[name].at(link.com) - frame.p, link.mass * _GRAVITY_M_S2)
    return torques


def lowest_shape(source: ArmSource, q: np.ndarray) -> tuple[str, float]:
    """Of the shapes that move, the name of the lowest in pose ``q`` (dof,) [rad] and its height over the base [m]."""
    frames = _frames(source, q)
    heights = {}
    for shape in source.shapes:
        if shape.link == source.base:
            continue
        frame = frames[shape.link]
        if isinstance(shape, Box):
            heights[shape.name] = float(frame.at(shape.center)[2] - np.abs(frame.R[2]) @ np.array(shape.half))
        else:
            ends = min(frame.at(shape.a)[2], frame.at(shape.b)[2])
            heights[shape.name] = float(ends - shape.radius)  # a cylinder's end taken as round: less is lower
    lowest = min(heights, key=heights.__getitem__)
    return lowest, heights[lowest]


def longest_offset(source: ArmSource) -> tuple[str, float]:
    """The joint, mount or tool that lies farthest from the frame it hangs off, and how far [m]."""
    offsets = {
        c.name if isinstance(c, Joint) else c.child: c.origin for c in (*source.joints, *source.mounts)
    }
    lengths = {
        name: float(np.linalg.norm(o))
        for name, o in {**offsets, source.tool.name: source.tool.origin}.items()
    }
    longest = max(lengths, key=lengths.__getitem__)
    return longest, lengths[longest]


def _frames(source: ArmSource, q: np.ndarray) -> dict[str, _Frame]:
    angle = {joint.name: float(value) for joint, value in zip(source.joints, q, strict=True)}
    frames = {source.base: _Frame(np.eye(3), np.zeros(3))}
    open_links = [source.base]
    while open_links:
        parent = open_links.pop()
        for child in source.children_of(parent):
            turn = (
                _about(_AXES[child.axis], angle[child.name])
                if isinstance(child, Joint)
                else _from_rpy(child.rpy)
            )
            frames[child.child] = _Frame(frames[parent].R @ turn, frames[parent].at(child.origin))
            open_links.append(child.child)
    return frames


def _carried(source: ArmSource, joint: Joint) -> list[str]:
    links = [joint.child]
    for link in links:  # grows while it is gone through
        links += [c.child for c in source.children_of(link)]
    return links


def _about(axis: np.ndarray, angle: float) -> np.ndarray:
    """Rodrigues' rotation."""
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _from_rpy(rpy: tuple[float, float, float]) -> np.ndarray:
    """URDF's fixed-axis roll, pitch, yaw."""
    roll, pitch, yaw = rpy
    return _about(_AXES["z"], yaw) @ _about(_AXES["y"], pitch) @ _about(_AXES["x"], roll)
