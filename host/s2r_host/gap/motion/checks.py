"""Does a recording belong to this model at all? Refusals for another robot, other units, swapped joints."""

from __future__ import annotations

import itertools
from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from s2r_host.gap.errors import GapRecordingError
from s2r_host.gap.motion.align import LawParts, law_parts
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import WRENCH_AXES, Session
from s2r_host.gap.recordings.recording import Controller, Recording
from s2r_host.gap.recordings.units import moves

RANGE_SLACK = 0.25
MAX_TURNS_RAD, MAX_SPEED_RAD_S = 200.0, 300.0  # more is taken for degrees, unless the unit is declared
LAW_SHAPE, LAW_SCALE = 0.8, 5.0  # a law this far off in size, followed this well in shape
CROSSED = 0.1  # of what a joint's own gains leave over: those of another joint leave less
LEAST_TURNED = 0.85  # R² under positions read as degrees, and how many times less it leaves over
TURNED_BETTER = 5.0
LEAST_TURN = 2.0 * np.pi  # a motion worth a log spans more degrees than this many radians


def check_joints(model: RigidModel, rec: Recording) -> list[str]:
    """Every recorded joint must exist in the model and stay near its range.

    Returns:
        Warnings: model joints that were not recorded.

    Raises:
        GapRecordingError: A joint is unknown, or a position cannot belong to it.
    """
    known = ", ".join(model.joints)
    for kind, table in rec.channels.items():
        if kind == "wrench":
            _check_wrenches(model, rec, table)
            continue
        for joint in table:
            if joint not in model.joints:
                raise GapRecordingError(
                    f"{rec.name}: column '{kind}.{joint}' names a joint the model does not have ({known}); "
                    "map it under 'joint_names' in the side file"
                )
    law = rec.controller
    for key, table in (
        ("controller.kp", law.kp), ("controller.kd", law.kd), ("controller.ki", law.ki),
        ("effort_sigma", rec.effort_sigma), ("effort_gain_sigma", rec.effort_gain_sigma),
        ("position_sigma", rec.position_sigma),
    ):  # fmt: skip
        for joint in table:
            if joint not in model.joints:
                raise GapRecordingError(
                    f"{rec.name}.yaml: {key} names '{joint}', a joint the model does not have ({known}); map it under "
                    "'joint_names'"
                )
    _check_dimensions(model, rec)
    for joint in rec.joints:
        _check_range(model, rec, joint)
        _check_command(rec, joint)
    led = {model.joints[t.follower]: model.joints[t.leader] for t in model.ties}
    missing = [j for j in model.joints if j not in rec.joints]
    if len(missing) == len(model.joints):
        raise GapRecordingError(f"{rec.name}: none of the model's joints ({known}) is recorded")
    return [
        f"{rec.name}: joint '{j}' is not recorded and "
        + (f"taken to follow '{led[j]}' as the model says" if j in led else "is held at its reference")
        for j in missing
    ]


def _check_dimensions(model: RigidModel, rec: Recording) -> None:
    """No hinge moves in millimetres or is driven by newtons, and no slide in degrees or by newton metres."""
    for column, unit in rec.units.items():
        kind, _, joint = column.partition(".")
        if kind in ("q", "dq", "q_cmd", "dq_cmd", "tau", "tau_ff") and moves(unit) != model.unit(joint):
            what = "turns" if model.unit(joint) == "rad" else "slides"
            raise GapRecordingError(
                f"{rec.name}: '{column}' is declared in {unit}, and '{joint}' {what}; declare the unit of this column "
                "by its own name under 'units' in the side file"
            )


def _check_wrenches(model: RigidModel, rec: Recording, columns: Iterable[str]) -> None:
    """Every wrench acts on a body that there is, along an axis."""
    bodies = [model.body_name(b) for b in range(model.model.nbody)]
    for column in columns:
        body, _, axis = column.rpartition(".")
        if body not in bodies or axis not in WRENCH_AXES:
            raise GapRecordingError(
                f"{rec.name}: column 'wrench.{column}' is on no body of the model ({', '.join(bodies)}) along one of "
                f"{', '.join(WRENCH_AXES)}"
            )


def _check_range(model: RigidModel, rec: Recording, joint: str) -> None:
    q = rec.channels["q"][joint]
    i = model.index(joint)
    low, high = model.model.jnt_range[i]
    limited = bool(model.model.jnt_limited[i]) and high > low
    lowest, highest = float(np.min(q)), float(np.max(q))
    unit = model.unit(joint)
    slack = RANGE_SLACK * (high - low) if limited else 0.0
    if limited and (lowest < low - slack or highest > high + slack):
        hint = " (is the file in degrees?)" if unit == "rad" and highest - lowest > 3 * (high - low) else ""
        raise GapRecordingError(
            f"{rec.name}: 'q.{joint}' spans [{lowest:.4g}, {highest:.4g}] {unit}, the model allows "
            f"[{low:.4g}, {high:.4g}]{hint}; another robot, another zero, or other units"
        )
    speed = np.abs(np.diff(q)) / np.diff(rec.t)
    turns = highest - lowest > MAX_TURNS_RAD or float(np.percentile(speed, 90)) > MAX_SPEED_RAD_S
    if unit == "rad" and turns and f"q.{joint}" not in rec.units:  # a wheel that says so turns on and on
        raise GapRecordingError(
            f"{rec.name}: 'q.{joint}' spans {highest - lowest:.4g} rad at up to {np.max(speed):.3g} rad/s; "
            "declare its unit under 'units' in the side file, 'deg' or, of what turns on and on, 'rad'"
        )


def _check_command(rec: Recording, joint: str) -> None:
    command = rec.get("q_cmd", joint)
    q = rec.channels["q"][joint]
    if command is None or np.std(command) < 1e-9 or np.std(q) < 1e-9:
        return
    slope = float(np.cov(command, q)[0, 1] / np.var(command))
    agreement = float(np.corrcoef(command, q)[0, 1])
    if agreement > 0.9 and not 0.1 < slope < 10.0:
        raise GapRecordingError(
            f"{rec.name}: 'q.{joint}' is {slope:.3g} times 'q_cmd.{joint}': one of them is in another unit; "
            "declare it under 'units' in the side file"
        )
    others = [j for j in rec.joints if j != joint and rec.get("q_cmd", j) is not None]
    for other in others:
        their_command = rec.channels["q_cmd"][other]
        if np.std(their_command) < 1e-9:
            continue
        mine = np.std(q - command)
        theirs = np.std(q - their_command)
        back = np.std(rec.channels["q"][other] - command)
        if theirs < 0.1 * mine and back < 0.1 * np.std(rec.channels["q"][other] - their_command):
            raise GapRecordingError(
                f"{rec.name}: 'q.{joint}' follows 'q_cmd.{other}' and the reverse: the joints are swapped"
            )


def check_efforts(model: RigidModel, s: Session) -> None:
    """Effort columns that fit another joint of the same arm far better are swapped.

    Raises:
        GapRecordingError: Two effort columns change places for a much better fit.
    """
    joints = [j for j in range(len(model.joints)) if s.has_u[j] and np.std(s.load[:, j]) > 1e-9]
    for i, j in itertools.combinations(joints, 2):
        own = _fit(s, i, i) * _fit(s, j, j)
        crossed = _fit(s, i, j) * _fit(s, j, i)
        if crossed > 0.7 and own < 0.15:
            raise GapRecordingError(
                f"{s.rec.name}: the effort of '{model.joints[i]}' fits '{model.joints[j]}' and the reverse "
                f"(R² product {crossed:.2f} against {own:.2f}): the joints are swapped"
            )
    for j in joints:
        # Means left out: friction of a joint that moves one way only shifts them.
        slope = float(np.cov(s.u[:, j], s.load[:, j])[0, 1] / np.var(s.load[:, j]))
        r2 = float(np.corrcoef(s.u[:, j], s.load[:, j])[0, 1])
        # Another unit scales all of the effort. A catch that a short stroke follows has a slope of its own alone.
        needed = np.abs(s.load[:, j]) + float(model.model.dof_frictionloss[j])
        size = float(np.sqrt(np.mean(s.u[:, j] ** 2) / np.mean(needed**2)))
        if r2 > 0.97 and ((slope > 20.0 and size > 5.0) or (0.0 < slope < 0.05 and size < 0.2)):
            raise GapRecordingError(
                f"{s.rec.name}: 'tau.{model.joints[j]}' is {slope:.3g} times what the model needs: another "
                "unit (N·mm?) or another robot; declare it under 'units' in the side file"
            )


def check_units(model: RigidModel, s: Session) -> None:
    """The declared control law, or the model's own load, must not fit far better in degrees or another unit.

    Raises:
        GapRecordingError: Positions are in degrees, or the gains of the side file belong to another unit.
    """
    for j, joint in enumerate(model.joints):
        if not s.has_u[j] or float(np.std(s.u[:, j])) < 1e-9:
            continue
        parts = law_parts(model, s, j) if s.has_drive[j] else None
        if parts is not None:
            ahead = s.channel("tau_ff", joint)
            ahead = np.zeros(len(s.t)) if ahead is None else ahead
            feedback = parts.kp + parts.kd + parts.rest - ahead
            _check_law_scale(s, joint, model.unit(joint), feedback, ahead, s.drive(j))
        if model.unit(joint) == "rad" and float(np.ptp(s.q[:, j])) > LEAST_TURN:
            own, turned = _fit(s, j, j), _fit_in_degrees(model, s, j)
            if turned > LEAST_TURNED and 1.0 - own > TURNED_BETTER * (1.0 - turned):
                raise GapRecordingError(
                    f"{s.rec.name}: the effort of '{joint}' fits the model when its positions are read as degrees "
                    f"(R² {turned:.2f} against {own:.2f}); declare 'q: deg' under 'units' in the side file"
                )


def check_gains(model: RigidModel, s: Session) -> None:
    """Efforts that follow the gains of another joint, and the reverse, are of swapped joints.

    Raises:
        GapRecordingError: All columns of two joints have changed places.
    """
    law, joints = s.rec.controller, np.flatnonzero(s.has_drive).tolist()
    parts = {j: found for j in joints if (found := law_parts(model, s, j)) is not None}
    for i, j in itertools.combinations(parts, 2):
        name, other = model.joints[i], model.joints[j]
        if all(
            np.std(s.drive(a) - _with_gains_of(model.joints[b], law, parts[a], model.joints[a]).total())
            < CROSSED * np.std(s.drive(a) - parts[a].total())
            for a, b in ((i, j), (j, i))
        ):
            raise GapRecordingError(
                f"{s.rec.name}: the effort of '{name}' follows the gains declared for '{other}' and the reverse: the "
                "joints are swapped; map them under 'joint_names' in the side file"
            )


def _with_gains_of(other: str, law: Controller, parts: LawParts, name: str) -> LawParts:
    """A joint's law under the gains of another one, position and speed; its own where it has none."""
    kp, kd = (gains.get(other, 0.0) / gains[name] if gains.get(name) else 1.0 for gains in (law.kp, law.kd))
    return replace(parts, kp=kp * parts.kp, kd=kd * parts.kd)


def _check_law_scale(
    s: Session, joint: str, unit: str, feedback: np.ndarray, ahead: np.ndarray, u: np.ndarray
) -> None:
    """Refuse a feedback that asks for many times the recorded effort while following its shape.

    What is fed forward is an effort and keeps its unit whatever the positions are in; it is taken out first.
    """
    others = np.stack([ahead, np.ones(len(u)), np.linspace(-1.0, 1.0, len(u))], axis=1)
    both = np.stack([feedback, u], axis=1)
    both = both - others @ np.linalg.lstsq(others, both, rcond=None)[0]
    power = np.maximum(np.sum(both**2, axis=0), 1e-30)
    along = float(both[:, 0] @ both[:, 1])
    slope, r2 = along / power[0], along**2 / (power[0] * power[1])
    if r2 > LAW_SHAPE and slope > 0 and not 1.0 / LAW_SCALE < slope < LAW_SCALE:
        degrees = unit == "rad" and abs(slope * 180.0 / np.pi - 1.0) < 0.3
        hint = "positions look like degrees: declare it" if degrees else "check gains and units"
        raise GapRecordingError(
            f"{s.rec.name}: 'tau.{joint}' is {slope:.3g} times what the declared controller asks for "
            f"(R² {r2:.2f}): {hint} under 'units' in the side file"
        )


def _fit_in_degrees(model: RigidModel, s: Session, j: int) -> float:
    """R² of a joint's effort on its load when hinge positions are converted from degrees."""
    turn = np.where([model.unit(name) == "rad" for name in model.joints], np.pi / 180.0, 1.0)
    load = model.inverse(s.q * turn, s.v * turn, s.a * turn)[:, j]
    X = np.stack([load, s.sign(j), s.v[:, j], np.ones(len(s.t))], axis=1)
    y = s.u[:, j]
    beta, *_ = np.linalg.lstsq(X, y, rcond=None)
    return float(max(0.0, 1.0 - np.var(y - X @ beta) / max(np.var(y), 1e-30))) if beta[0] > 0 else 0.0


def _fit(s: Session, effort: int, load: int) -> float:
    """R² of one joint's effort on another joint's load, speed sign and speed."""
    X = np.stack([s.load[:, load], s.sign(load), s.v[:, load], np.ones(len(s.t))], axis=1)
    y = s.u[:, effort]
    beta, *_ = np.linalg.lstsq(X, y, rcond=None)
    return float(max(0.0, 1.0 - np.var(y - X @ beta) / max(np.var(y), 1e-30)))
