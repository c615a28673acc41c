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
# What the model leaves out (calibration of the camera, edge fattening, play): a floor per quantity.
FLOOR_TILT_RAD = np.radians(0.5)
FLOOR_SHIFT_M = 0.0025
FLOOR_SLIDE_M = 0.0006
FLOOR_TURN_RAD = np.radians(0.5)
# A lever's few hundred pixels sit on rims that stereo matching fattens by some pixels, differently before and after.
THIN_TILT_RAD = np.radians(2.5)
THIN_SHIFT_M = 0.003
THIN_TURN_RAD = np.radians(0.8)
# Slow waves in the depth tilt a whole plate by about this much per metre of noise; a hinge found from two plates that
# differ by an angle inherits it divided by 2 sin(angle / 2). On real laptop lids (noise 1.5 mm) this gives the errors
# seen: 1-3 degrees at 13-24 degrees of motion, 5 degrees at 8.
PLATE_TILT_RAD_PER_M = np.radians(0.25) / 0.001
PLATE_SHIFT_PER_NOISE = 0.6
# Opposite faces of a plate before and after: its faces need not be parallel, and one of them is seen at a low angle.
TURNED_TILT_RAD = np.radians(1.0)
LEAST_PLATE_M = 0.003  # hardly a lid is thinner: the fit of its thickness went astray, and with it the hinge
UNLIKELY_PLATE = 2.5
TURNED_SHIFT_M = 0.004
# A plate that one of the views shows by its edge alone: the rim's depth is smeared, which turns the plate. Validation
# laptops 0 to 60 and 300 to 313; the shift is divided by 2 sin(angle / 2) like that of tilted plates.
EDGE_ON_TURN_RAD = np.radians(1.2)
EDGE_ON_TILT_RAD = np.radians(0.7)
EDGE_ON_SHIFT_M = 0.005


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
    weighted: list[tuple[Refined, float]],
    centre: Array,
    noise_m: float,
    thin: bool = False,
    edge_on: bool = False,
) -> Intervals:
    """Intervals of the first (best) motion, widened by the others of its family in proportion to belief.

    Args:
        weighted: Refined motions with their share of belief, best first.
        centre: Middle of the part [m], shape (3,); offsets are judged there.
        noise_m: Depth noise on the part [m].
        thin: The part is a lever.
        edge_on: One of the views shows little more of the part than its edge.
    """
    best = weighted[0][0]
    lever = 0.0
    kind = best.motion.joint_type
    unsure = UNLIKELY_PLATE if best.plate_m is not None and best.plate_m < LEAST_PLATE_M else 1.0
    covariance = best.covariance
    tilt2 = (
        float(max(np.trace(covariance[:2, :2]) / 2, 0.0)) + (THIN_TILT_RAD if thin else FLOOR_TILT_RAD) ** 2
    )
    if kind == "revolute":
        lever = 1.0 / max(2.0 * float(np.sin(best.motion.delta / 2)), 0.02)
        tilt2 += (PLATE_TILT_RAD_PER_M * noise_m * lever) ** 2
    if best.plate_m is not None:
        tilt2 += (unsure * TURNED_TILT_RAD) ** 2
    if edge_on:
        tilt2 += (EDGE_ON_TILT_RAD * lever) ** 2
    floor_turn = THIN_TURN_RAD if thin else FLOOR_TURN_RAD
    floor_delta = floor_turn if kind == "revolute" else FLOOR_SLIDE_M
    delta2 = float(covariance[-1, -1]) + floor_delta**2
    shift2 = 0.0
    if kind == "revolute":
        shift2 = float(np.trace(covariance[2:4, 2:4]) / 2) + (THIN_SHIFT_M if thin else FLOOR_SHIFT_M) ** 2
        shift2 += (PLATE_SHIFT_PER_NOISE * noise_m * lever) ** 2
        if best.plate_m is not None:  # a thickness off by e puts the hinge e / (2 sin(angle / 2)) off
            shift2 += (unsure * TURNED_SHIFT_M * max(lever, 1.0)) ** 2
        if edge_on:
            shift2 += (EDGE_ON_SHIFT_M * lever) ** 2
            delta2 += EDGE_ON_TURN_RAD**2
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


def _reach90(distance: Array, weight: Array) -> float:
    """The distance within which 90 % of the belief lies."""
    order = np.argsort(distance, kind="stable")
    share = np.cumsum(weight[order]) / max(float(weight.sum()), 1e-12)
    return float(distance[order][min(int(np.searchsorted(share, 0.9)), len(order) - 1)])
