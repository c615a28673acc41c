"""Candidate motions from the structure of what moved: normals, plane crossings, edges, pivots.

A hypothesis source is a function ``(Structure) -> list of axes``; a network's modes join as one more source.
Every axis is then scanned over its joint value by `scan`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.change import Change
from s2r_host.perception.evidence import Probe, Scene, score, thinned
from s2r_host.perception.levers import (
    Column,
    Lever,
    bisector_pivots,
    columns,
    lever_directions,
    line_pivots,
    line_within,
)
from s2r_host.perception.motion import JointMotion, perpendicular_basis
from s2r_host.perception.planes import Plane, crossing_line, find_planes
from s2r_protocol.targets import JointType

Array = NDArray[np.floating]

ACROSS_COLUMNS = 2  # bodies
ACROSS_STEP_M, ACROSS_STEP_RAD = 0.025, np.radians(20)  # along their axis and about it
FEW_POINTS = 70
Z = np.array([0.0, 0.0, 1.0])
SLIDES_M = np.concatenate([np.arange(0.008, 0.1, 0.008), np.arange(0.1, 0.42, 0.016)])
TURNS_RAD = np.radians(np.concatenate([np.arange(4, 40, 4.0), np.arange(40, 125, 8.0)]))


@dataclass(frozen=True, eq=False)
class Axis:
    """A line (revolute) or a direction (prismatic) without a joint value; ``source`` says where it came from."""

    joint_type: JointType
    origin: Array
    direction: Array
    source: str


@dataclass(frozen=True, eq=False)
class Structure:
    """Flat pieces of what moved and of what surrounds it.

    Attributes:
        moved: Planes among points that left (first view).
        arrived: Planes among points that appeared or may have appeared (second view).
        static: Planes of the unchanged surroundings.
        low, high: Box around the moved points [m], shape (3,).
        levers: Lines of a thin part before and after the motion, if it is thin.
        thin_axes: Candidate axes of a thin part.
        columns: Of round bodies that stayed, beside a small part.
        upright: Unit vector against gravity, (3,); z where that is unknown.
    """

    moved: list[Plane]
    arrived: list[Plane]
    static: list[Plane]
    low: Array
    high: Array
    levers: tuple[Lever | None, Lever | None]
    thin_axes: list[Axis]
    columns: list[Column]
    upright: Array

    def fronts(self) -> Array:
        """Normals of the large moved or arrived planes, shape (n, 3)."""
        planes = self.moved + self.arrived
        largest = max((plane.size for plane in planes), default=0)
        return np.array([plane.normal for plane in planes if plane.size > 0.4 * largest]).reshape(-1, 3)


def structure(scene: Scene, rng: np.random.Generator, up: Array | None = None) -> Structure:
    """Find the planes that suggest axes."""
    a, b = scene.moved_before(), scene.moved_after()
    low, high = np.percentile(scene.moved_points(), [2, 98], axis=0)
    margin = 0.15
    box_before = _inside(scene.before.points, low - margin, high + margin) & scene.before.normal_ok
    box_after = _inside(scene.after.points, low - margin, high + margin) & scene.after.normal_ok
    left = (scene.changes.before != Change.STATIC) & box_before & scene.candidate_before
    came = (scene.changes.after != Change.STATIC) & box_after & scene.candidate_after
    rest = (scene.changes.before == Change.STATIC) & box_before
    left_points, came_points = scene.before.points[a], scene.after.points[b]
    lines = line_within(left_points, scene.before), line_within(came_points, scene.after)
    return Structure(
        moved=_planes(scene.before, left, rng, 5),
        arrived=_planes(scene.after, came, rng, 5),
        static=_planes(scene.before, rest, rng, 4),
        low=low,
        high=high,
        levers=lines,
        thin_axes=_thin_axes(lines, (left_points, came_points), up) if lines != (None, None) else [],
        columns=_columns(scene, lines, (left_points, came_points), up),
        upright=Z if up is None else up,
    )


def axes(shape: Structure) -> list[Axis]:
    """All candidate axes, each once: see `_distinct`."""
    found = _slides(shape) + _crossings(shape) + _edges(shape)
    found += [Axis("revolute", one.centre, one.direction, "round body") for one in shape.columns]
    found += _across_columns(shape) + shape.thin_axes + _pivots(shape)
    return _distinct(found)


def scan(found: list[Axis], scene: Scene, before: Probe, after: Probe) -> tuple[list[JointMotion], Array]:
    """Try every axis at a grid of joint values in both senses; motions and their costs.

    A few points sort out the hopeless three quarters; their cost is left at what those points say.
    """
    motions: list[JointMotion] = []
    for axis in found:
        values = SLIDES_M if axis.joint_type == "prismatic" else TURNS_RAD
        for value in values:
            motions.append(JointMotion(axis.joint_type, axis.origin, axis.direction, float(value)))
            motions.append(JointMotion(axis.joint_type, axis.origin, -axis.direction, float(value)))
    cost = score(motions, scene, thinned(before, FEW_POINTS), thinned(after, FEW_POINTS), extra_m=0.006)
    hopeful = np.argsort(cost, kind="stable")[: max(500, len(motions) // 4)]
    cost += 1.0  # judged by few points: behind all the others
    cost[hopeful] = score([motions[i] for i in hopeful], scene, before, after, extra_m=0.006)
    return motions, cost


def best_distinct(
    motions: list[JointMotion], cost: Array, anchors: Array, most: int
) -> list[tuple[JointMotion, float]]:
    """The cheapest motions that move the anchor points (n, 3) differently, both families represented."""
    chosen: list[tuple[JointMotion, float]] = []
    where: list[Array] = []
    quota = {"prismatic": most // 3, "revolute": most - most // 3}
    for i in np.argsort(cost, kind="stable")[:3000]:
        motion = motions[int(i)]
        if quota[motion.joint_type] == 0:
            continue
        X = motion.transform()
        at = anchors @ X[:3, :3].T + X[:3, 3]
        near = [
            j
            for j, other in enumerate(where)
            if np.sqrt(((at - other) ** 2).sum(axis=1).mean()) < 0.012
            and chosen[j][0].joint_type == motion.joint_type
        ]
        if near:
            continue
        quota[motion.joint_type] -= 1
        chosen.append((motion, float(cost[i])))
        where.append(at)
        if not any(quota.values()):
            break
    return chosen


def _inside(points: Array, low: Array, high: Array) -> NDArray[np.bool_]:
    return np.all((points >= low) & (points <= high), axis=1)


def _planes(view: object, mask: NDArray[np.bool_], rng: np.random.Generator, most: int) -> list[Plane]:
    index = np.flatnonzero(mask)
    if len(index) < 60:
        return []
    index = rng.permutation(index)[:5000]
    return find_planes(view.points[index], view.normals[index], rng, most)  # type: ignore[attr-defined]


def _slides(shape: Structure) -> list[Axis]:
    centre = 0.5 * (shape.low + shape.high)
    found = []
    for name, planes in (("moved", shape.moved), ("arrived", shape.arrived), ("static", shape.static)):
        for plane in planes:
            found.append(Axis("prismatic", centre, plane.normal, f"normal of a {name} plane"))
    for plane in shape.moved[:2]:
        for direction in plane.edge_directions:
            found.append(Axis("prismatic", centre, direction, "edge of a moved plane"))
    found.append(Axis("prismatic", centre, shape.upright, "vertical"))
    return found


def slides_beside(shape: Structure, directions: Sequence[Array]) -> list[Axis]:
    """Slides along directions (3,) that are known from parts beside this one."""
    centre = 0.5 * (shape.low + shape.high)
    return [Axis("prismatic", centre, one, "along a part beside") for one in directions]


def _crossings(shape: Structure) -> list[Axis]:
    found = []
    pairs = [(a, b, "moved x arrived") for a in shape.moved for b in shape.arrived]
    pairs += [(a, b, "moved x static") for a in shape.moved for b in shape.static]
    pairs += [(a, b, "arrived x static") for a in shape.arrived for b in shape.static]
    for a, b, name in pairs:
        line = crossing_line(a, b)
        if line is None:
            continue
        point, direction = line
        nearest = point + direction * (direction @ (0.5 * (shape.low + shape.high) - point))
        if _inside(nearest[None], shape.low - 0.2, shape.high + 0.2)[0]:
            found.append(Axis("revolute", nearest, direction, f"crossing {name}"))
    return found


def _edges(shape: Structure) -> list[Axis]:
    found = []
    for name, planes in (("moved", shape.moved[:3]), ("arrived", shape.arrived[:3])):
        for plane in planes:
            for i in range(4):
                a, b = plane.corners[i], plane.corners[(i + 1) % 4]
                length = float(np.linalg.norm(b - a))
                if length > 0.02:
                    found.append(Axis("revolute", 0.5 * (a + b), (b - a) / length, f"edge of a {name} plane"))
    return found


def _pivots(shape: Structure) -> list[Axis]:
    """Axes along plane normals and the vertical through a 5 x 5 grid over the moved region."""
    directions = [shape.upright]
    directions += [plane.normal for plane in shape.static[:3] + shape.moved[:2]]
    centre, half = 0.5 * (shape.low + shape.high), 0.5 * (shape.high - shape.low)
    found = []
    for direction in directions:
        e1, e2 = perpendicular_basis(direction)
        r1, r2 = np.abs(e1) @ half + 0.02, np.abs(e2) @ half + 0.02
        for s in np.linspace(-1, 1, 5):
            for t in np.linspace(-1, 1, 5):
                found.append(Axis("revolute", centre + s * r1 * e1 + t * r2 * e2, direction, "pivot grid"))
    return found


def _across_columns(shape: Structure) -> list[Axis]:
    """Lines square to the axis of a round body, through it: levers at the side of a tap turn about one of them."""
    found = []
    centre, half = 0.5 * (shape.low + shape.high), 0.5 * (shape.high - shape.low)
    for column in [one for one in shape.columns if one.sure][:ACROSS_COLUMNS]:
        e1, e2 = perpendicular_basis(column.direction)
        middle = float((centre - column.centre) @ column.direction)
        reach = float(np.abs(column.direction) @ half) + ACROSS_STEP_M
        heights = np.arange(middle - reach, middle + reach, ACROSS_STEP_M)
        for angle in np.arange(0.0, np.pi, ACROSS_STEP_RAD):
            direction = np.cos(angle) * e1 + np.sin(angle) * e2
            found += [
                Axis("revolute", column.centre + h * column.direction, direction, "across a round body")
                for h in heights
            ]
    return found


def _columns(
    scene: Scene, lines: tuple[Lever | None, Lever | None], points: tuple[Array, Array], up: Array | None
) -> list[Column]:
    """What a small part may turn about: levers, knobs and taps sit on a round body."""
    if not scene.small():
        return []
    directions = lever_directions(*lines, *_middles(points), up)
    return [one for direction in directions for one in columns(scene, direction, scene.moved_points())]


def _middles(points: tuple[Array, Array]) -> tuple[Array, Array]:
    """Of what left and of what appeared [m], (3,) each; of the one that was seen where the other was not."""
    middles = [np.median(p, axis=0) for p in points if len(p)]
    return middles[0], middles[-1]


def _thin_axes(
    lines: tuple[Lever | None, Lever | None], points: tuple[Array, Array], up: Array | None
) -> list[Axis]:
    """Axes of a lever: where its two lines cross, and where it is carried over."""
    a, b = lines
    p_a, p_b = _middles(points)
    found = []
    for direction in lever_directions(a, b, p_a, p_b, up):
        pivots: list[tuple[Array, str]] = []
        if a is not None and b is not None:
            pivots += [(p, "lines of a lever") for p in line_pivots(a, b, direction)]
        for line in (a, b):
            if line is not None:
                pivots += [(p, "line of a lever") for p in bisector_pivots(line, p_a, p_b, direction)]
        found += [Axis("revolute", p, direction, source) for p, source in pivots]
    return found


def _distinct(found: list[Axis]) -> list[Axis]:
    """Earlier axes win over later ones within 3 degrees and 12 mm of them."""
    direction = np.array([axis.direction for axis in found]).reshape(-1, 3)
    origin = np.array([axis.origin for axis in found]).reshape(-1, 3)
    slides = np.array([axis.joint_type == "prismatic" for axis in found], dtype=bool)
    kept: list[int] = []
    for i in range(len(found)):
        same = slides[kept] == slides[i]
        same &= np.abs(direction[kept] @ direction[i]) >= np.cos(np.radians(3))
        if not slides[i]:
            gap = origin[i] - origin[kept]
            along = np.einsum("nk,nk->n", gap, direction[kept])
            same &= np.einsum("nk,nk->n", gap, gap) - along**2 < 0.012**2
        if not same.any():
            kept.append(i)
    return [found[i] for i in kept]
