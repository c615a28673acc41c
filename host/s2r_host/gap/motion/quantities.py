"""What a residual is drawn over: the quantity of a recorded motion by which an effect betrays itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from s2r_host.gap.motion.kinematics import transmitted
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.session import Session, lowpass, wrench_parts

MOVES = 3.0  # times the noise of the speed, beyond which a joint has turned round

Along = Callable[[RigidModel, Session, int, Mapping[str, float]], np.ndarray]


@dataclass(frozen=True)
class Quantity:
    """One quantity, as an axis of a map.

    Attributes:
        words: What the axis says; ``{joint}`` stands for the joint, ``{other}`` for another one that the effect names.
        unit: Unit from the unit of position (``{q}``) and of effort (``{tau}``), of the other joint (``{q_other}``).
        along: Model, recording, joint and the effect's shape -> values, shape (time,).
        turned: The residual counts against the motion there: friction then has one sign in both directions.
    """

    words: str
    unit: str
    along: Along
    turned: bool = False

    def label(self, model: RigidModel, joint: int, shape: Mapping[str, float]) -> str:
        """Text of the axis, with its unit."""
        name = model.joints[joint]
        other = model.joints[int(shape["other"])] if "other" in shape else name
        units = {"q": model.unit(name), "tau": model.effort_unit(name), "q_other": model.unit(other)}
        unit = self.unit.format(**units)
        words = self.words.format(joint=name, other=other)
        return f"{words} [{unit}]" if unit else words


def since_turn(s: Session, joint: int) -> np.ndarray:
    """Way since the joint last turned round [rad or m], signed as the motion, shape (time,)."""
    q, v = s.q[:, joint], s.v[:, joint]
    moving = np.flatnonzero(np.abs(v) > MOVES * s.v_eps[joint])
    if not moving.size:
        return q - q[0]
    turns = np.flatnonzero(np.diff(np.sign(v[moving])) != 0)
    ends = [0]
    for k in turns:  # the farthest point between the last row of one stroke and the first of the next
        first, last = int(moving[k]), int(moving[k + 1])
        way = np.sign(v[first]) * q[first : last + 1]
        ends.append(first + int(np.argmax(way)))
    last_turn = np.searchsorted(ends, np.arange(len(q)), side="right") - 1
    return q - q[np.array(ends)[last_turn]]


def _pull(s: Session, joint: int, model: RigidModel, which: str) -> np.ndarray:
    parts = wrench_parts(model, s, joint)
    return np.zeros(len(s.t)) if parts is None else np.asarray(getattr(parts, which))


def _at_rest(model: RigidModel, s: Session, joint: int) -> np.ndarray:
    still = np.zeros_like(s.q)
    return model.inverse(s.q, still, still)[:, joint]


def _effort_slope(s: Session, joint: int) -> np.ndarray:
    return np.gradient(lowpass(s.drive(joint), float(s.cut[joint]), s.dt), s.dt)


def _phase(model: RigidModel, s: Session, joint: int, shape: Mapping[str, float]) -> np.ndarray:
    return np.mod(shape["order"] * s.q[:, joint], 2.0 * np.pi)


def _other(x: str) -> Along:
    return lambda model, s, j, shape: getattr(s, x)[:, int(shape.get("other", j))]


POSITION = Quantity("position", "{q}", lambda model, s, j, shape: s.q[:, j])
SPEED = Quantity("speed", "{q}/s", lambda model, s, j, shape: s.v[:, j])
DIRECTION = Quantity("direction of motion, sign of the speed", "", lambda model, s, j, shape: s.sign(j))
ACCELERATION = Quantity("acceleration", "{q}/s²", lambda model, s, j, shape: s.a[:, j])
LOAD = Quantity("load that the model needs", "{tau}", lambda model, s, j, shape: s.load[:, j])
LOAD_SIZE = Quantity(
    "size of the load", "{tau}", lambda model, s, j, shape: np.abs(s.load[:, j]), turned=True
)
WEIGHT_SIZE = Quantity(
    "size of the weight at rest",
    "{tau}",
    lambda model, s, j, shape: np.abs(_at_rest(model, s, j)),
    turned=True,
)
EFFORT = Quantity("effort of the drive", "{tau}", lambda model, s, j, shape: s.drive(j))
EFFORT_SLOPE = Quantity("change of the effort", "{tau}/s", lambda model, s, j, shape: _effort_slope(s, j))
TIME = Quantity("time", "s", lambda model, s, j, shape: s.t)
WARMING_UP = Quantity("time since the start", "s", lambda model, s, j, shape: s.t, turned=True)
RECORDING = Quantity(
    "recording, in the order given, and how far into it",
    "",
    lambda model, s, j, shape: s.index + 1.0 + 0.8 * s.t / max(float(s.t[-1]), 1e-9),
    turned=True,
)
PHASE = Quantity("position within one period, as an angle", "rad", _phase)
RUBBING_PHASE = Quantity("position within one period, as an angle", "rad", _phase, turned=True)
SINCE_TURN = Quantity("way since the last reversal", "{q}", lambda model, s, j, shape: since_turn(s, j))
TRANSMITTED = Quantity(
    "effort in the transmission, which winds it up",
    "{tau}",
    lambda model, s, j, shape: transmitted(model, s, j),
)
OTHER_SPEED = Quantity("speed of '{other}'", "{q_other}/s", _other("v"))
OTHER_ACCELERATION = Quantity("acceleration of '{other}'", "{q_other}/s²", _other("a"))
PULL = Quantity(
    "pull of the wrench along the joint", "{tau}", lambda model, s, j, shape: _pull(s, j, model, "along")
)
ACROSS = Quantity(
    "force across the joint", "N", lambda model, s, j, shape: _pull(s, j, model, "across"), turned=True
)
RACKING = Quantity(
    "moment of the pull beside the centre",
    "N·m",
    lambda model, s, j, shape: _pull(s, j, model, "racking"),
    turned=True,
)
