"""The object's joint as the arm felt it: a recording with position and effort of a joint that has no sensor.

While the fingertip pushes the part, the part is where its surface meets the fingertip, and the joint's effort is the
fingertip's force times the part's motion. Such a log is a recording of one joint like any other: ``s2r gap`` reads it.
"""

from __future__ import annotations

import csv
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from scipy.ndimage import binary_closing
from scipy.signal import savgol_filter

from s2r_host.motion.arm_model import ArmModel
from s2r_host.proprioception.following import Followed, PushedPart, follow
from s2r_host.proprioception.own_torques import OwnTorques
from s2r_host.proprioception.samples import EVERY_S, Samples
from s2r_host.proprioception.stick_slip import MEAN_S, averaged, runs, stick_slips
from s2r_host.proprioception.tip_force import TipForce, tip_force

# Along the joint and at all, from which on something is touched. Where a spring below friction pulls the part along,
# half a newton is left to push with.
OVER_NOISE, LEAST_FORCE_N = 4.0, 0.5
IMPACT_S, IMPACT = 0.02, 0.25  # an effort that changes so fast, by this share of its median, is a blow
GAP_S = 0.05  # shorter breaks belong to a touch
LEAST_TOUCH_S = 0.25
EDGE_S = 0.05  # at both ends of a touch the fingertip is still landing or leaving
WINDOW_S = 0.08  # of the smoothing of the joint's position
# Of an effort: millimetres that place and axis are off, on a lever of a hand's breadth; on a slide, what is left of how
# it leans once that was learnt.
LEVER_SHARE, SLIDE_SHARE = 0.05, 0.08
LEVER_GAIN = 0.04  # by which a lever is longer or shorter than believed all along a touch
# Of the search range: a fingertip that moves the part less jams, or leans on what it rests on.
LEAST_WAY = 0.02
# The place pushed goes slower, by itself or beside what it reaches: friction is anything up to its limit there.
STANDS_M_S, STANDS_SHARE = 0.003, 0.15
ALONE = 9.0  # misfit of one force at the fingertip from which on something else is touched, or felt wrongly
COMES_TO_REST_M_S = 0.006  # the part ends with the fingertip, and not a millimetre further
# How far a part's surface is off along its way, one standard deviation, and at worst; how far off a hinge is seen.
SURFACE_M, SURFACE_AT_WORST_M, SEEN_RAD = 0.0012, 0.01, 0.012
LEAST_LEVER_M = 0.01  # nobody pushes a hinge's part nearer to its axis
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
        s_sigma: How far its joint values may be off all along [m or rad].
    """

    t: np.ndarray
    s: np.ndarray
    ds: np.ndarray
    effort: np.ndarray
    sigma: np.ndarray
    s_sigma: float


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
    sign = 1.0 if part.positive else -1.0
    pushing = (size > LEAST_FORCE_N) & (sign * towards > OVER_NOISE * doubt)
    contact = binary_closing(pushing, np.ones(2 * round(GAP_S / EVERY_S / 2) + 1))
    struck = _blows(towards, contact)
    speed = np.linalg.norm(np.gradient(force.p, EVERY_S, axis=0), axis=1)
    slipping = stick_slips(contact, struck, speed)
    followed, found = list[Followed](), list[Touch]()
    for stretch, slips in _stretches(contact & ~struck, slipping):
        s_now = float(followed[-1].s[-1]) if followed else s_start
        one = follow(arm, samples, stretch, part, s_now, s_end, most)
        if one is None:
            continue
        followed.append(one)
        felt = tip_force(own, samples.part(one.rows), one.p)
        made = _in_the_mean(samples, one, part, felt) if slips else _steady(samples, one, part, felt)
        found += [
            touch
            for touch in made
            if len(touch.t) * EVERY_S >= LEAST_TOUCH_S and np.ptp(touch.s) >= LEAST_WAY * most
        ]
    if not found:
        return []
    last = followed[-1]
    off = s_end - float(last.s[-1])
    if _speed(last, part)[-1] >= COMES_TO_REST_M_S:  # the part has gone on alone: where it was met counts
        met = follow(arm, samples, np.flatnonzero(contact)[:1], part, s_start, s_end, most)
        at_start = s_start - float(met.s[0]) if met is not None else off
        worst = SURFACE_AT_WORST_M / _lever(last, part)
        if abs(at_start) > max(
            worst, abs(off)
        ):  # met with another place of the part than the one it was pushed at
            at_start = off
        # A part that ends behind the fingertip has not gone on: something else was felt before the part was.
        off = at_start if sign * (off - at_start) > -worst else off
    return [replace(one, s=one.s + off) for one in found]


def _stretches(steady: np.ndarray, slipping: list[np.ndarray]) -> list[tuple[np.ndarray, bool]]:
    """Rows of contact without blows (n,), and of sticking and slipping, in order, without the edges of each."""
    apart = steady.copy()
    for bout in slipping:
        apart[bout] = False
    found = [(rows, False) for rows in runs(apart)] + [(rows, True) for rows in slipping]
    edge = round(EDGE_S / EVERY_S)
    return [(rows[edge:-edge], slips) for rows, slips in sorted(found, key=lambda one: one[0][0])]


def _steady(samples: Samples, one: Followed, part: PushedPart, force: TipForce) -> list[Touch]:
    """The stretches of a steady push that are clear."""
    return [
        _touch(samples, some, part, force.part(some.rows - one.rows[0]))
        for some in _clear(one, part, force.misfit < ALONE)
    ]


def _in_the_mean(samples: Samples, one: Followed, part: PushedPart, force: TipForce) -> list[Touch]:
    """A part that sticks and slips, in running means; nothing where something else is touched or the lever changes."""
    short = len(one.s) <= round(2.0 * MEAN_S / EVERY_S)
    if short or _other_lever(part.velocity(one.p)).any() or np.median(force.misfit) > ALONE:
        return []
    touch = _touch(samples, one, part, force)
    s = averaged(one.s)
    ds = np.gradient(s, EVERY_S)
    return [Touch(averaged(touch.t), s, ds, averaged(touch.effort), averaged(touch.sigma), touch.s_sigma)]


def _touch(samples: Samples, one: Followed, part: PushedPart, force: TipForce) -> Touch:
    effort, sigma = force.along(part.velocity(one.p), part.turning)
    disagrees = np.sqrt(np.maximum(force.misfit, 1.0))  # Birge (1932): such a value is not known so well
    s_sigma = float(np.hypot(SURFACE_M / _lever(one, part), SEEN_RAD if part.turning.any() else 0.0))
    return Touch(samples.t[one.rows], *_smoothed(one.s), effort, sigma * disagrees, s_sigma)


def _lever(one: Followed, part: PushedPart) -> float:
    """How far the place pushed goes per unit of the joint: 1 on a slide, not next to nothing on a hinge [m]."""
    return max(float(np.median(np.linalg.norm(part.velocity(one.p), axis=1))), LEAST_LEVER_M)


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


def _clear(one: Followed, part: PushedPart, alone: np.ndarray) -> list[Followed]:
    """The stretches in which the part goes, on a lever that is known, and the fingertip is all that touches (n,)."""
    speed, velocity = _speed(one, part), part.velocity(one.p)
    going = np.flatnonzero(speed > max(STANDS_M_S, STANDS_SHARE * float(speed.max())))
    if not len(going):
        return []
    clear = (speed > 0.0) & alone  # a part does not go against the fingertip: that has slid along it
    clear[: going[0]] = clear[going[-1] + 1 :] = False
    for changes in one.s[1:][_other_lever(velocity)]:
        clear &= np.abs(one.s - changes) > TURN_RAD
    return [Followed(one.rows[i], one.s[i], one.p[i]) for i in runs(clear)]


def _other_lever(velocity: np.ndarray) -> np.ndarray:
    """Where the lever is another one than a row before, (n - 1,), of motions per unit of the joint (n, 3)."""
    lever = np.linalg.norm(velocity, axis=1)
    return np.linalg.norm(np.diff(velocity, axis=0), axis=1) > OTHER_LEVER * lever[1:]


def _speed(one: Followed, part: PushedPart) -> np.ndarray:
    """How fast the place pushed goes with the fingertip [m/s], (n,), negative where it comes back."""
    sign = 1.0 if part.positive else -1.0
    return sign * np.linalg.norm(part.velocity(one.p), axis=1) * _smoothed(one.s)[1]


def _smoothed(s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joint values (n,) without their ripple, and their speeds; as far as so few rows have any."""
    window = min(2 * round(WINDOW_S / EVERY_S / 2) + 1, 2 * ((len(s) - 1) // 2) + 1)
    if window < 3:
        return s, np.zeros(len(s))
    smooth, ds = (savgol_filter(s, window, 2, deriv=order, delta=EVERY_S) for order in (0, 1))
    return np.asarray(smooth), np.asarray(ds)


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
            "position_sigma": {joint: one.s_sigma} if hinged else {},
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
