"""90 % intervals of an estimate: the refinement's covariance plus the spread of surviving hypotheses."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.motion import line_distance
from s2r_host.perception.refine import Refined

Array = NDArray[np.floating]

Z90 = 1.645
CHI90_2 = 2.146  # radius of the 90 % disc of a 2D normal distribution
# What the model leaves out (edge fattening, waves in the depth, hands) shows in the residual: errors grow with it.
# Floors and slopes from validation drawers and laptops 1000 to 1059. The slopes of hinges leave real lids of 14 to 23
# degrees of motion (residuals of 0.6 to 2.3 mm) their errors of 1 to 3 degrees.
SLIDE_TILT_RAD, SLIDE_TILT_RAD_PER_M = np.radians(0.08), np.radians(0.4) / 0.001
SLIDE_M, SLIDE_PER_RESIDUAL = 0.00005, 0.4
FLOOR_TILT_RAD = np.radians(0.15)
FLOOR_SHIFT_M = 0.001
FLOOR_TURN_RAD, TURN_RAD_PER_M = np.radians(0.05), np.radians(0.22) / 0.001
# A lever's few hundred pixels sit on rims that stereo matching fattens by some pixels, differently before and after.
THIN_TILT_RAD = np.radians(2.5)
MOUNTED_RAD = np.radians(0.25)
THIN_SHIFT_M = 0.003
THIN_TURN_RAD = np.radians(0.8)
# Slow waves in the depth tilt a whole plate in proportion to the residual; a hinge found from two plates that differ by
# an angle inherits that divided by 2 sin(angle / 2).
PLATE_TILT_RAD_PER_M = np.radians(0.22) / 0.001
PLATE_SHIFT_PER_RESIDUAL = 0.45
# Opposite faces of a plate before and after: its faces need not be parallel, and one of them is seen at a low angle.
TURNED_TILT_RAD = np.radians(0.6)
LEAST_PLATE_M = 0.003  # hardly a lid is thinner: the fit of its thickness went astray, and with it the hinge
UNLIKELY_PLATE = 2.5
TURNED_SHIFT_M = 0.0025
# A plate that one of the views shows by its edge alone: the rim's depth is smeared, which turns the plate. Validation
# laptops 0 to 60 and 300 to 313; the shift is divided by 2 sin(angle / 2) like that of tilted plates.
EDGE_ON_TURN_RAD = np.radians(1.2)
EDGE_ON_TILT_RAD = np.radians(0.5)
EDGE_ON_SHIFT_M = 0.0045


@dataclass(frozen=True, eq=False)
class Intervals:
    """90 % intervals.

    Attributes:
        axis_angle_rad: The true direction lies within this angle.
        axis_offset_m: The true line passes the estimated origin within this distance (0 for a slide).
        delta: Low and high end of the motion [rad or m].
    """

    axis_angle_rad: float
    axis_offset_m: float
    delta: tuple[float, float]


def intervals90(
    weighted: list[tuple[Refined, float]], centre: Array, thin: bool = False, edge_on: bool = False
) -> Intervals:
    """Intervals of the first (best) motion, widened by the others of its family in proportion to belief.

    Args:
        weighted: Refined motions with their share of belief, best first.
        centre: Middle of the part [m], shape (3,); offsets are judged there.
        thin: The part is a lever.
        edge_on: One of the views shows little more of the part than its edge.
    """
    best = weighted[0][0]
    kind = best.motion.joint_type
    tilt2, shift2, delta2 = _slide(best) if kind == "prismatic" else _turn(best, thin, edge_on)
    same = [(r, w) for r, w in weighted if r.motion.joint_type == kind]
    foot = (
        best.motion.origin + ((centre - best.motion.origin) @ best.motion.direction) * best.motion.direction
    )
    weight = np.array([w for _, w in same])
    tilt = np.arccos(np.clip([best.motion.direction @ r.motion.direction for r, _ in same], -1, 1))
    shift = np.array([line_distance(r.motion.origin, r.motion.direction, foot[None])[0] for r, _ in same])
    turn = np.array([abs(r.motion.delta - best.motion.delta) for r, _ in same])
    half = float(np.hypot(Z90 * np.sqrt(delta2), _reach90(turn, weight)))
    offset = (
        float(np.hypot(CHI90_2 * np.sqrt(shift2), _reach90(shift, weight))) if kind == "revolute" else 0.0
    )
    return Intervals(
        axis_angle_rad=float(min(np.hypot(CHI90_2 * np.sqrt(tilt2), _reach90(tilt, weight)), np.pi)),
        axis_offset_m=offset,
        delta=(best.motion.delta - half, best.motion.delta + half),
    )


def _slide(best: Refined) -> tuple[float, float, float]:
    """Variances of a slide's direction [rad²], of its line (0) and of its motion [m²]."""
    tilt2 = float(max(np.trace(best.covariance[:2, :2]) / 2, 0.0))
    tilt2 += SLIDE_TILT_RAD**2 + (SLIDE_TILT_RAD_PER_M * best.residual_m) ** 2
    delta2 = float(best.covariance[-1, -1]) + SLIDE_M**2 + (SLIDE_PER_RESIDUAL * best.residual_m) ** 2
    return tilt2, 0.0, delta2


def _turn(best: Refined, thin: bool, edge_on: bool) -> tuple[float, float, float]:
    """Variances of a hinge's direction [rad²], line [m²] and motion [rad²]."""
    covariance, residual_m = best.covariance, best.residual_m
    lever = 1.0 / max(2.0 * float(np.sin(best.motion.delta / 2)), 0.02)
    tilt2 = (
        float(max(np.trace(covariance[:2, :2]) / 2, 0.0)) + (PLATE_TILT_RAD_PER_M * residual_m * lever) ** 2
    )
    shift2 = float(np.trace(covariance[2:4, 2:4]) / 2) + (PLATE_SHIFT_PER_RESIDUAL * residual_m * lever) ** 2
    delta2 = float(covariance[-1, -1])
    if thin:  # of the direction's two angles those that are as mounted are not read off the rims
        tilt2 += (best.exact * MOUNTED_RAD**2 + (2 - best.exact) * THIN_TILT_RAD**2) / 2
        shift2 += THIN_SHIFT_M**2
        delta2 += THIN_TURN_RAD**2
    else:
        tilt2 += FLOOR_TILT_RAD**2
        shift2 += FLOOR_SHIFT_M**2
        delta2 += FLOOR_TURN_RAD**2 + (TURN_RAD_PER_M * residual_m) ** 2
    if best.plate_m is not None:  # a thickness off by e puts the hinge e / (2 sin(angle / 2)) off
        unsure = UNLIKELY_PLATE if best.plate_m < LEAST_PLATE_M else 1.0
        tilt2 += (unsure * TURNED_TILT_RAD) ** 2
        shift2 += (unsure * TURNED_SHIFT_M * max(lever, 1.0)) ** 2
    if edge_on:
        tilt2 += (EDGE_ON_TILT_RAD * lever) ** 2
        shift2 += (EDGE_ON_SHIFT_M * lever) ** 2
        delta2 += EDGE_ON_TURN_RAD**2
    return tilt2, shift2, delta2


def _reach90(distance: Array, weight: Array) -> float:
    """The distance within which 90 % of the belief lies."""
    order = np.argsort(distance, kind="stable")
    share = np.cumsum(weight[order]) / max(float(weight.sum()), 1e-12)
    return float(distance[order][min(int(np.searchsorted(share, 0.9)), len(order) - 1)])
