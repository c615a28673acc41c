"""The object's joint as the arm felt it: a recording with position and effort of a joint that has no sensor.

While the fingertip pushes the part, the part is where its surface meets the fingertip, and the joint's effort is the
fingertip's force times the part's motion. Such a log is a recording of one joint like any other: ``s2r gap`` reads it.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import coal
import numpy as np
import yaml
from scipy.ndimage import binary_closing
from scipy.optimize import brentq
from scipy.signal import savgol_filter

from s2r_host.motion.arm_model import ArmModel
from s2r_host.motion.obstacles import Obstacle
from s2r_host.proprioception.own_torques import OwnTorques
from s2r_host.proprioception.samples import EVERY_S, Samples
from s2r_host.proprioception.tip_force import tip_force

OVER_NOISE, LEAST_FORCE_N = 4.0, 1.0  # from which on something is touched
IMPACT_S, IMPACT = 0.02, 0.25  # an effort that changes so fast, by this share of its median, is a blow
GAP_S = 0.05  # shorter breaks belong to a touch
LEAST_TOUCH_S = 0.25
EDGE_S = 0.05  # at both ends of a touch the fingertip is still landing or leaving
TOUCH = 1e-6  # joint values are found this closely [m or rad]
STEPS = 60
CLEAR_M, EVERY_ROWS = 0.01, 4  # nearer than this a fingertip may touch: the part is known to millimetres
NEAR = 0.02  # of the search range: as far as a part goes between two rows
WINDOW_S = 0.08  # of the smoothing of the joint's position
# Of an effort: millimetres that place and axis are off, on a lever of a hand's breadth; on a slide, what is left of how
# it leans once that was learnt.
LEVER_SHARE, SLIDE_SHARE = 0.05, 0.08
LEVER_GAIN = 0.04  # by which a lever is longer or shorter than believed all along a touch
LEAST_WAY = (
    0.02  # of the search range: a fingertip that moves the part less jams, or leans on what it rests on
)
# The place pushed goes slower, by itself or beside what it reaches: friction is anything up to its limit there.
STANDS_M_S, STANDS_SHARE = 0.003, 0.15
COMES_TO_REST_M_S = 0.006  # the part ends with the fingertip, and not a millimetre further
# Flat on flat, the place nearest to the part changes from one edge of the fingertip to the other within a fraction of
# a degree. Where that changes a lever, the place is not known until the part has turned by what its shape is off.
OTHER_LEVER, TURN_RAD = 0.05, 0.05


@dataclass(frozen=True, eq=False)
class Touch:
    """One stretch of time in which the fingertip pushed the part.

    Attributes:
        t: Time [s], (n,).
        s: Joint value [m or rad], (n,).
        ds: Its speed, (n,).
        effort: Of the arm on the joint, positive where it makes it grow [N or N·m], (n,).
        sigma: Standard error of the effort, (n,).
    """

    t: np.ndarray
    s: np.ndarray
    ds: np.ndarray
    effort: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True, eq=False)
class PushedPart:
    """The part as a fingertip meets it.

    Attributes:
        shapes: Its pieces at joint value 0, base frame.
        pose: X (4, 4) of the part at a joint value, base frame.
        velocity: Motion of points (n, 3) of the part per unit of the joint, (n, 3).
        positive: The joint grows when it is pushed.
    """

    shapes: Sequence[Obstacle]
    pose: Callable[[float], np.ndarray]
    velocity: Callable[[np.ndarray], np.ndarray]
    positive: bool


def touches(
    own: OwnTorques,
    arm: ArmModel,
    samples: Samples,
    part: PushedPart,
    s_start: float,
    s_end: float,
    most: float,
) -> list[Touch]:
    """The stretches of a motion in which the fingertip moved the part.

    Args:
        own: What the arm itself takes.
        arm: Its fingertip.
        samples: The motion.
        part: What was pushed.
        s_start: Joint value before the motion [m or rad].
        s_end: After it, [m or rad]: where the part ended with the fingertip its surface counts from there, as its shape
            is known to millimetres; otherwise from ``s_start``.
        most: How far the joint may be from ``s_end`` at most [m or rad].
    """
    force = tip_force(own, samples)
    towards, doubt = force.along(part.velocity(force.p))
    size = np.linalg.norm(force.force_N, axis=1)
    noise = np.sqrt(np.trace(force.covariance, axis1=1, axis2=2))
    sign = 1.0 if part.positive else -1.0
    pushing = (size > np.maximum(LEAST_FORCE_N, OVER_NOISE * noise)) & (sign * towards > OVER_NOISE * doubt)
    contact = binary_closing(pushing, np.ones(2 * round(GAP_S / EVERY_S / 2) + 1))
    followed: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    edge, s_now = round(EDGE_S / EVERY_S), s_start
    for stretch in _stretches(contact & ~_blows(towards, contact)):
        rows = stretch[edge:-edge]
        places = _followed(arm, samples.q[rows], part, s_now, s_end, most) if len(rows) else None
        if places is not None:
            together = _unbroken(places[0], NEAR * most)
            followed.append((rows[together], places[0][together], places[1][together]))
            s_now = float(followed[-1][1][-1])
    found = []
    for rows, s, p in followed:
        velocity = part.velocity(p)
        for some in _clear(s, velocity):
            if len(some) * EVERY_S < LEAST_TOUCH_S or np.ptp(s[some]) < LEAST_WAY * most:
                continue
            effort, sigma = tip_force(own, samples.part(rows[some]), p[some]).along(velocity[some])
            smooth, ds = _smoothed(s[some])
            found.append(Touch(samples.t[rows[some]], smooth, ds, effort, sigma))
    if not found:
        return []
    _, s, p = followed[-1]
    if _along(s, part.velocity(p))[-1] < COMES_TO_REST_M_S:
        off = s_end - float(s[-1])
    else:  # the part has gone on alone: where it was met counts
        met = _followed(arm, samples.q[np.flatnonzero(contact)[:1]], part, s_start, s_end, most)
        off = s_start - float(met[0][0]) if met is not None else 0.0
    return [replace(one, s=one.s + off) for one in found]


def _blows(effort: np.ndarray, pushing: np.ndarray) -> np.ndarray:
    """Where the fingertip lands anew or jumps from one place of the part to another, (n,) as the effort (n,).

    Such a blow sets the arm swinging: what its drives feel meanwhile is not what the joint takes.
    """
    rows = round(IMPACT_S / EVERY_S)
    if not pushing.any() or len(effort) <= rows:
        return np.zeros(len(effort), dtype=bool)
    struck = np.zeros(len(effort), dtype=bool)
    change = np.abs(effort[rows:] - effort[:-rows])
    struck[: len(change)] = change > IMPACT * float(np.median(np.abs(effort[pushing])))
    return np.convolve(struck, np.ones(rows + 1), "full")[: len(effort)] > 0.0


def free_rows(arm: ArmModel, samples: Samples, part: PushedPart, s: float) -> int:
    """How many rows at the beginning of a motion pass before the fingertip comes near the part, still at ``s``."""
    for row in range(0, len(samples), EVERY_ROWS):
        if _Apart(arm, samples.q[row], part)(s) < CLEAR_M:
            return max(0, row - EVERY_ROWS)
    return len(samples)


def _stretches(mask: np.ndarray) -> list[np.ndarray]:
    """Rows of every unbroken run of a mask (n,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], mask.astype(int), [0]])))
    return [np.arange(start, stop) for start, stop in zip(edges[::2], edges[1::2], strict=True)]


def _unbroken(s: np.ndarray, step: float) -> np.ndarray:
    """Rows of the longest stretch of joint values (n,) without a jump: a fingertip has several places on a part."""
    breaks = np.flatnonzero(np.abs(np.diff(s)) > step) + 1
    return max(np.split(np.arange(len(s)), breaks), key=len)


def _clear(s: np.ndarray, velocity: np.ndarray) -> list[np.ndarray]:
    """Rows of the stretches in which the part goes, and on a lever that is known.

    Args:
        s: Joint values (n,).
        velocity: Of the place pushed per unit of the joint, (n, 3).
    """
    speed = _along(s, velocity)
    going = np.flatnonzero(speed > max(STANDS_M_S, STANDS_SHARE * float(speed.max())))
    if not len(going):
        return []
    clear = speed > 0.0  # a part does not go against the fingertip: that has slid along it
    clear[: going[0]] = clear[going[-1] + 1 :] = False
    lever = np.linalg.norm(velocity, axis=1)
    other = np.linalg.norm(np.diff(velocity, axis=0), axis=1) > OTHER_LEVER * lever[1:]
    for changes in s[1:][other]:
        clear &= np.abs(s - changes) > TURN_RAD
    return _stretches(clear)


def _along(s: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """How fast the place pushed goes [m/s], (n,), negative where it comes back.

    Args:
        s: Joint values (n,).
        velocity: Of the place per unit of the joint, (n, 3).
    """
    towards = np.sign(s[-1] - s[0])
    return towards * np.linalg.norm(velocity, axis=1) * _smoothed(s)[1]


def _smoothed(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joint values (n,) without their ripple, and their speeds; as far as so few rows have any."""
    window = min(2 * round(WINDOW_S / EVERY_S / 2) + 1, 2 * ((len(s) - 1) // 2) + 1)
    if window < 3:
        return s, np.zeros(len(s))
    smooth, ds = (savgol_filter(s, window, 2, deriv=order, delta=EVERY_S) for order in (0, 1))
    return np.asarray(smooth), np.asarray(ds)


def _followed(
    arm: ArmModel, q: np.ndarray, part: PushedPart, s_now: float, s_end: float, most: float
) -> tuple[np.ndarray, np.ndarray] | None:
    """Joint values at which the part just touches the fingertip, (n,), and where, (n, 3); None if it nowhere does.

    The part is ahead of the fingertip; moved back towards it, it touches at some value and overlaps beyond. Another
    place of the part, the inside of a drawer's back for one, may do so too, at another value: the touch begins with
    the one nearest to ``s_now``, where the part was until then.
    """
    back = -most if part.positive else most
    found: list[float] = []
    touched: list[np.ndarray] = []
    for row in q:
        apart = _Apart(arm, row, part)
        near = found[-1] if found else None
        span = None if near is None else _bracket(apart, (near - NEAR * back, near + NEAR * back))
        if span is None:
            values = np.linspace(s_end - back, s_end + back, STEPS)
            spans = (_bracket(apart, (float(a), float(b))) for a, b in pairwise(values))
            expected = s_now if near is None else near
            span = min(
                (one for one in spans if one is not None),
                key=lambda one: abs(sum(one) / 2.0 - expected),
                default=None,
            )
        if span is None:
            return None
        found.append(float(brentq(apart, *span, xtol=TOUCH)))  # pyright: ignore[reportArgumentType]
        apart(found[-1])
        touched.append(apart.nearest)
    return np.array(found), np.array(touched)


def _bracket(apart: Callable[[float], float], span: tuple[float, float]) -> tuple[float, float] | None:
    """The span if the fingertip is free at its first end and inside the part at its second."""
    return span if apart(span[0]) > 0.0 >= apart(span[1]) else None


class _Apart:
    """Distance of the fingertip from the part at a joint value [m], negative inside."""

    def __init__(self, arm: ArmModel, q: np.ndarray, part: PushedPart) -> None:
        placements = arm.shape_placements(q)
        self._tip = [
            (
                arm.shapes.geometryObjects[i].geometry,
                coal.Transform3s(placements[i].rotation, placements[i].translation),
            )
            for i in sorted(arm.tip_shapes)
        ]
        self._part = part
        self.nearest = np.zeros(3)  # on the fingertip, of the last call, base frame [m]

    def __call__(self, s: float) -> float:
        X, least = self._part.pose(s), np.inf
        for shape in self._part.shapes:
            there = X @ shape.X_base_shape
            placed = coal.Transform3s(there[:3, :3], there[:3, 3])
            for geometry, here in self._tip:
                result = coal.DistanceResult()
                distance = coal.distance(
                    geometry, here, shape.geometry, placed, coal.DistanceRequest(), result
                )
                if distance < least:
                    least, self.nearest = distance, np.array(result.getNearestPoint1()).ravel()
        return float(least)


def write_log(
    touched: Sequence[Touch], joint: str, folder: Path, name: str, session: str, *, hinged: bool
) -> list[Path]:
    """Write one recording (CSV and YAML, as ``s2r gap`` takes them) per touch; earlier ones of the name go.

    Args:
        touched: Stretches of contact.
        joint: Name of the object's joint.
        folder: Created when missing.
        name: Of the files; a number is added.
        session: What was recorded in one go.
        hinged: The joint is a hinge: efforts are forces times levers.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for old in (*folder.glob(f"{name}-*.csv"), *folder.glob(f"{name}-*.yaml")):
        old.unlink()
    paths = []
    for number, one in enumerate(touched, start=1):
        path = folder / f"{name}-{number}.csv"
        with path.open("w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            writer.writerow(["t", f"q.{joint}", f"dq.{joint}", f"tau.{joint}"])
            for row in zip(one.t - one.t[0], one.s, one.ds, one.effort, strict=True):
                writer.writerow([f"{value:.7g}" for value in row])
        side = {
            "controller": {"type": "none"},
            "effort": "measured",
            "effort_sigma": {joint: _accuracy(one, hinged)},
            "effort_gain_sigma": {joint: LEVER_GAIN} if hinged else {},
            "input": "effort",
            "session": session,
            "notes": "joint followed by the fingertip, effort from the arm's joint torques",
        }
        path.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
        paths.append(path)
    return paths


def _accuracy(touch: Touch, hinged: bool) -> float:
    """How far the effort of a touch may be off, by the gauge and by what the axis is known to [N or N·m]."""
    axis = (LEVER_SHARE if hinged else SLIDE_SHARE) * np.abs(touch.effort)
    return float(np.median(np.hypot(touch.sigma, axis)))
