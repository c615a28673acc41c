"""Mass, dry and viscous friction of an object's joint and the lean of a rail, from what the arm felt while pushing it.

The builder guesses mass from a guessed density, and friction is invisible. One push holds the sum of weight, friction
and damping; how it changes along the way and with the speed tells them apart as far as it can, and a prior as wide as
the guess decides the rest: what a push does not show, it does not change.

Rails and hinges may stick: friction then grows where a touch slows down, and that is where the inertia of the part is
felt, too. Without that in the equation the mass stands for it.

A rail is seen to lean to half a degree, by which the weight of a full drawer pulls as much as a light one rubs. What
pulls more than that is neither lean nor a heavier part: where the data ask for such a pull, it is fitted beside them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from scipy.optimize import lsq_linear

from s2r_host.proprioception.object_log import Touch

MASS_SHARE_SIGMA, MASS_SHARE_RANGE = 1.0, (0.3, 5.0)
FRICTION_SIGMA = 3.0  # of the median effort: nearly anything
DAMPING_SIGMA = 0.1  # of the median effort at the median speed: hinges and rails rub, few are damped
STICTION_SIGMA = 1.0  # of the median effort: the share by which friction may grow where the part moves slowly
LEAN_SIGMA, LEAN_MOST = 0.006, 0.015  # rad, of a slide, from what was seen
PULL_SIGMA = 1.0  # of the median effort
PULL_EVIDENCE, PULL_SHARE = 10.0, 0.2  # of the misfit: a pull takes so much of it away, and this share
STICTION_SHARES = (0.1, 0.2, 0.4)  # of the highest speed: where it falls off is not known
MODEL_SHARE = 0.1  # of an effort, that no constant friction explains: joints stick and slip
ROWS_TOGETHER = 20  # errors of so many rows go together (0.1 s)
OUTLIER, ROUNDS = 1.5, 5  # a fingertip that jams between part and rest feels more than the joint
SLOW_SHARE = 0.1  # of the highest speed: below it friction holds, and does not tell its size


@dataclass(frozen=True)
class ObjectNumbers:
    """What was learnt of a joint.

    Attributes:
        mass_share: Mass of the part over its mass in the model.
        friction: Dry friction at the speeds of the touches, stiction included [N or N·m].
        damping: Viscous friction [N·s/m or N·m·s/rad].
        lean: A slide rises more than the model's by this where its joint grows [rad]; 0 for a hinge.
        sigma: Standard errors of the first three, prior included.
        rest: Effort left over, root mean square [N or N·m].
        effort: Effort felt, root mean square [N or N·m].
    """

    mass_share: float
    friction: float
    damping: float
    lean: float
    sigma: tuple[float, float, float]
    rest: float
    effort: float


def learn_numbers(mjcf: Path, joint: str, touched: Sequence[Touch]) -> ObjectNumbers | None:
    """Bounded least squares, robust after Huber.

    Effort = share · (weight + inertia + lean) + friction · sign(speed) + damping · speed.

    Args:
        mjcf: The object as built.
        joint: Its joint.
        touched: What was felt; empty gives None.
    """
    if not touched:
        return None
    rows = [_rows(mjcf, joint, one) for one in touched]
    A, b = np.concatenate([r[0] for r in rows]), np.concatenate([r[1] for r in rows])
    noise = np.concatenate([r[2] for r in rows])
    fastest = float(np.abs(A[:, 2]).max())
    fits = {
        pull: min(
            (_fit(_with_hidden(A, share * fastest, pull), b, noise) for share in STICTION_SHARES),
            key=lambda found: found[0],
        )
        for pull in (False, True)
    }
    (without, plain), (with_pull, pulled) = fits[False], fits[True]
    return pulled if without - with_pull > max(PULL_EVIDENCE, PULL_SHARE * without) else plain


def _with_hidden(A: np.ndarray, speed: float, pull: bool) -> np.ndarray:
    """Regressor (n, 4) with columns for what sticks below a speed [m/s or rad/s] and for a steady pull, (n, 6).

    Their numbers are not learnt here: without them in the equation others stand for them.
    """
    stiction = A[:, 1] * np.exp(-((A[:, 2] / speed) ** 2))
    return np.column_stack([A, stiction, np.full(len(A), float(pull))])


def _fit(A: np.ndarray, b: np.ndarray, noise: np.ndarray) -> tuple[float, ObjectNumbers]:
    """Misfit, prior included, and the numbers of a regressor (n, 6), effort (n,) and its standard error (n,)."""
    size = float(np.median(np.abs(b)))
    sigma = np.hypot(noise, MODEL_SHARE * size) * np.sqrt(ROWS_TOGETHER)
    dull = DAMPING_SIGMA * size / np.median(np.abs(A[:, 2]))
    hidden = (STICTION_SIGMA * size, PULL_SIGMA * size)
    prior = np.array([MASS_SHARE_SIGMA, FRICTION_SIGMA * size, dull, LEAN_SIGMA, *hidden])
    usual = np.array([1.0, size, 0.0, 0.0, 0.0, 0.0])
    (low, high), trust = MASS_SHARE_RANGE, np.ones(len(b))
    x, left, a, y = usual, np.abs(b), A, b
    for _ in range(ROUNDS):
        scaled = np.sqrt(trust) / sigma
        leaning = np.array([1.0, 1.0, 1.0, x[0], 1.0, 1.0])  # the more, the heavier the part
        a = np.vstack([A * leaning * scaled[:, None], np.diag(1.0 / prior)])
        y = np.concatenate([b * scaled, usual / prior])
        least = [low, 0.0, 0.0, -LEAN_MOST, 0.0, -np.inf]
        most = [high, np.inf, np.inf, LEAN_MOST, np.inf, np.inf]
        x = lsq_linear(a, y, bounds=(least, most)).x
        left = np.abs(b - A * leaning @ x)
        trust = np.minimum(
            1.0, OUTLIER * np.maximum(np.median(left) / 0.6745, noise) / np.maximum(left, 1e-12)
        )
    sticks = float(np.mean(np.abs(A[:, 4])))
    told = np.eye(3, len(x))
    # Both err together: where the part is slow all along hardly anything tells one from the other.
    told[1, 4] = sticks
    spread = np.sqrt(np.diag(told @ np.linalg.inv(a.T @ a) @ told.T))
    misfit = float(np.sum((a @ x - y) ** 2))
    return misfit, ObjectNumbers(
        mass_share=float(x[0]),
        friction=float(x[1] + x[4] * sticks),
        damping=float(x[2]),
        lean=float(x[3]),
        sigma=(float(spread[0]), float(spread[1]), float(spread[2])),
        rest=float(np.sqrt(np.mean(left**2))),
        effort=float(np.sqrt(np.mean(b**2))),
    )


def explained(mjcf: Path, joint: str, touch: Touch, numbers: ObjectNumbers) -> np.ndarray:
    """Effort that the numbers ask for along a touch [N or N·m], (n,).

    Args:
        mjcf: The object as built.
        joint: Its joint.
        touch: Position and speed.
        numbers: As learnt for that object.
    """
    share = numbers.mass_share
    return _regressor(mjcf, joint, touch) @ [share, numbers.friction, numbers.damping, share * numbers.lean]


def _rows(mjcf: Path, joint: str, touch: Touch) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Regressor (n, 4), effort (n,) and its standard error (n,) where the part moves."""
    moving = np.abs(touch.ds) > SLOW_SHARE * np.abs(touch.ds).max()
    return _regressor(mjcf, joint, touch)[moving], touch.effort[moving], touch.sigma[moving]


def _regressor(mjcf: Path, joint: str, touch: Touch) -> np.ndarray:
    """Effort per mass share, friction, damping and lean, (n, 4).

    The acceleration comes from a speed that was smoothed before; at both ends of a touch it means little.
    """
    model = mujoco.MjModel.from_xml_path(str(mjcf))
    data = mujoco.MjData(model)
    qpos, dof = model.joint(joint).qposadr[0], model.joint(joint).dofadr[0]
    dds = np.gradient(touch.ds, touch.t)
    inertia = np.zeros((model.nv, model.nv))
    lean = _per_lean(model, data, model.joint(joint).id)
    A = []
    for s, ds, a in zip(touch.s, touch.ds, dds, strict=True):
        data.qpos[qpos] = s
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, inertia)
        A.append((float(data.qfrc_bias[dof]) + inertia[dof, dof] * a, np.sign(ds), ds, lean))
    return np.array(A)


def _per_lean(model: mujoco.MjModel, data: mujoco.MjData, joint: int) -> float:
    """Effort by which a slide's part resists per radian that the slide rises more [N/rad]; 0 for a hinge."""
    if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_SLIDE:
        return 0.0
    mujoco.mj_forward(model, data)
    level = np.linalg.norm(np.cross(data.xaxis[joint], model.opt.gravity))
    return float(model.body_subtreemass[model.jnt_bodyid[joint]] * level)
