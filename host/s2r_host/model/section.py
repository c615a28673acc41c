"""The cross-section of a bar, from where two views see its faces and where its outline ends.

A stereo camera sees a bar of a centimetre from one side, and how thick it is tells neither its faces nor the smeared
rim of its depth. Its outline in colour does: every line of sight past an edge touches the cross-section. Seen by two
cameras, or by one before and after the bar has turned, that leaves little but what both have hidden.

Rectangles and circles are tried. The sides of a rectangle stand across the motion, as those of levers do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.floating]

# Errors that all points of a view, or all of one edge in it, have in common; more points do not average them out.
SURFACE_SIGMA_M, OUTLINE_SIGMA_M = 0.001, 0.0006
RIM_SIGMA_M = 0.002  # of an edge that only the depth image shows
SURFACE_ENOUGH, OUTLINE_ENOUGH = 40, 15  # so many points tell half of what any number of them does
SURFACE_HUBER_M, OUTLINE_HUBER_M = 0.003, 0.0015
HALF_M, HALF_SIGMA_M = 0.010, 0.004  # half of what levers measure across
LEAST_HALF_M, MOST_HALF_M = 0.003, 0.02
SLOPE_SIGMA = 0.05  # of the bar's line against the one it was cut along
GRAZING = 0.15  # sine, below which a face shows nothing
STEPS, DAMPING, DONE_M = 40, 0.5, 1e-6


@dataclass(frozen=True, eq=False)
class SectionLook:
    """What one view shows of a bar, in the bar's frame: along it, along its motion, and across both.

    Attributes:
        surface: Points on its faces [m], (n, 3).
        towards: Unit vector to the camera within the cross-section, (2,).
        edges: Per edge, at least one: its points [m] and the outward normals of the planes through camera and edge,
            (m, 3) each.
        sharp: The edges are outlines in colour, not rims of a depth image.
    """

    surface: Array
    towards: Array
    edges: tuple[tuple[Array, Array], ...]
    sharp: bool


@dataclass(frozen=True, eq=False)
class Section:
    """A cross-section.

    Attributes:
        centre: Along and across the motion, where the along-coordinate is 0 [m], (2,).
        slope: How far it moves per metre along, (2,).
        half: Half its width along and across the motion; twice the radius of a circle [m], (2,).
        circle: It is one.
        cost: Twice the negative log-likelihood, to compare shapes with.
    """

    centre: Array
    slope: Array
    half: Array
    circle: bool
    cost: float


def fit_section(looks: Sequence[SectionLook]) -> Section:
    """The rectangle or circle that explains the views better.

    Args:
        looks: At least one with points on a surface.
    """
    return min((_fit(looks, circle) for circle in (False, True)), key=lambda section: section.cost)


def _fit(looks: Sequence[SectionLook], circle: bool) -> Section:
    """Gauss-Newton with Huber weights over centre (2), slope (2) and half widths (2) or radius (1).

    Every point says the same of a convex shape: in some direction n its farthest place, n·centre + h(n), is n·p. For an
    edge n is the normal of the plane of sight, for a face that of the nearest place on the visible side.
    """
    x = np.concatenate([_start(looks), np.zeros(2), np.full(1 if circle else 2, HALF_M)])
    mean = np.r_[np.zeros(4), np.full(len(x) - 4, HALF_M)]
    precise = np.r_[
        np.zeros(2), np.full(2, SLOPE_SIGMA**-2), np.full(len(x) - 4, HALF_SIGMA_M**-2)
    ]  # of the prior
    cost = np.inf
    for _ in range(STEPS):
        H, g = np.diag(precise), precise * (x - mean)
        cost = float((precise * (x - mean) ** 2).sum())
        for p, n, sigma, huber in _tangents(looks, x, circle):
            size = np.linalg.norm(n, axis=1)[:, None] if circle else np.abs(n)
            J = -np.column_stack([n, n * p[:, :1], size])
            off = np.einsum("ni,ni->n", n, p[:, 1:] - x[:2] - p[:, :1] * x[2:4]) - size @ x[4:]
            weight = np.minimum(1.0, huber / np.maximum(np.abs(off), 1e-12)) / (len(p) * sigma**2)
            H += J.T @ (J * weight[:, None])
            g += J.T @ (weight * off)
            cost += float((weight * np.abs(off) * np.maximum(np.abs(off), 2.0 * np.abs(off) - huber)).sum())
        step = -np.linalg.solve(H + 1e-9 * np.eye(len(x)), g)
        x = x + DAMPING * step
        x[4:] = np.clip(x[4:], LEAST_HALF_M, MOST_HALF_M)
        if np.abs(step).max() < DONE_M:
            break
    return Section(x[:2], x[2:4], np.broadcast_to(x[4:], 2), circle, cost)


def _start(looks: Sequence[SectionLook]) -> Array:
    """Middle of what is seen, a usual half width further back, (2,)."""
    return np.mean([np.median(one.surface[:, 1:], axis=0) - HALF_M * one.towards for one in looks], axis=0)


def _tangents(
    looks: Sequence[SectionLook], x: Array, circle: bool
) -> list[tuple[Array, Array, float, float]]:
    """Points (m, 3), directions (m, 2), their common error and the distance from which on one is doubted [m]."""
    found = []
    for look in looks:
        d = look.surface[:, 1:] - x[:2] - look.surface[:, :1] * x[2:4]
        n = _facing_circle(d, look.towards) if circle else _facing_corner(d, look.towards, x[4:])
        shared = SURFACE_SIGMA_M * np.sqrt(1.0 + SURFACE_ENOUGH / len(d))
        found.append((look.surface, n, float(shared), SURFACE_HUBER_M))
        for p, across in look.edges:
            shared = OUTLINE_SIGMA_M * np.sqrt(1.0 + OUTLINE_ENOUGH / len(p)) if look.sharp else RIM_SIGMA_M
            found.append(
                (p, across[:, 1:], float(shared), OUTLINE_HUBER_M if look.sharp else SURFACE_HUBER_M)
            )
    return found


def _facing_circle(d: Array, towards: Array) -> Array:
    """Outward normals at the places nearest to points (n, 2) about the centre; the far half is a shadow, (n, 2)."""
    aside = np.array([-towards[1], towards[0]])
    shadow = np.sign(d @ aside)[:, None] * aside
    radial = d / np.maximum(np.linalg.norm(d, axis=1, keepdims=True), 1e-9)
    return np.where((d @ towards > 0.0)[:, None], radial, shadow)


def _facing_corner(d: Array, towards: Array, half: Array) -> Array:
    """Outward normals at the places nearest to points (n, 2) about the centre, on the two faces seen, (n, 2)."""
    side = np.sign(towards)
    beyond = np.where(np.abs(towards) < GRAZING, -np.inf, side * d - half)
    corner = np.all(beyond > 0.0, axis=1)
    face = np.eye(2)[np.argmax(beyond, axis=1)] * side
    outward = np.where(corner[:, None], beyond, 0.0)
    outward = side * outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    return np.where(corner[:, None], outward, face)
