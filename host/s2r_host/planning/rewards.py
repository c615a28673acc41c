"""The paper's reward, one function per term, each with the repair it needed.

Paper: Ma et al., Sim2Real²: Actively Building Explicit Physics Model for Precise Articulated Object
Manipulation, ICRA 2023, section "Sampling-based Model Predictive Control": the reward of a step is the sum of
r_dist, r_target, r_contact, r_reg and r_success; a sequence is worth the mean over its steps.
As printed, three of the five terms reward the wrong thing; each function says what was changed and why.
Arrays are (rollout, step) or (rollout, step, dof); each function returns (rollout, step).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np

from s2r_host.planning.settings import RewardWeights


@dataclass(frozen=True)
class Task:
    """What the reward compares with: start, goal and success band of the object's joint [m or rad], and its kind."""

    s_initial: float
    s_target: float
    tolerance: float
    prismatic: bool = True


@dataclass(frozen=True)
class StepFacts:
    """What the reward needs to know about every step of every rollout.

    Attributes:
        distance_m: Fingertip to its point on the part, (rollout, step).
        turn_rad: Angle between the tool and its orientation at that point, (rollout, step).
        s: Joint of the object [m or rad], (rollout, step).
        ds: Its speed [m/s or rad/s], (rollout, step).
        touches: The fingertip touches the part, bool (rollout, step).
        collides: The robot touches anything else, bool (rollout, step).
        press_N: Force of the fingertip on the part across the part's motion, (rollout, step).
        dq: Joint speeds [rad/s], (rollout, step, dof).
        ddq: Joint accelerations [rad/s²], (rollout, step, dof).
        load: Servo torque without gravity compensation over the joint's torque limit, (rollout, step, dof).
    """

    distance_m: np.ndarray
    turn_rad: np.ndarray
    s: np.ndarray
    ds: np.ndarray
    touches: np.ndarray
    collides: np.ndarray
    press_N: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    load: np.ndarray


def r_dist(distance_m: np.ndarray, turn_rad: np.ndarray, weights: RewardWeights) -> np.ndarray:
    """Distance term: -w (||p_tip - p_part||² + (l turn)²).

    Repair: printed with a plus, which pays for going away. The second part is ours: behind a handle the orientation
    decides whether the hand fits, and the distance alone knows nothing of it; l = 0 is the paper's term.
    """
    squared = distance_m**2 + (weights.turn_m * turn_rad) ** 2
    width = weights.distance_width_m
    return -weights.distance * 2.0 * width**2 * (np.sqrt(1.0 + squared / width**2) - 1.0)


def remaining(s: np.ndarray, task: Task) -> np.ndarray:
    """Share of the way that remains, |s_target - s| / |s_target - s_initial|; 1 at the start, 0 on target."""
    return np.abs(task.s_target - s) / abs(task.s_target - task.s_initial)


def r_target(s: np.ndarray, task: Task, weights: RewardWeights) -> np.ndarray:
    """Approach term: -w times the remaining share. Repair: absolute value; the printed ratio pays for overshoot."""
    return -weights.target * remaining(s, task)


def on_target(s: np.ndarray, task: Task) -> np.ndarray:
    """True within the success band. Repair: one band per joint type; the paper has 0.005 for m and rad alike."""
    return np.abs(task.s_target - s) < task.tolerance


def r_success(s: np.ndarray, task: Task, weights: RewardWeights) -> np.ndarray:
    """Success term: +w within the band. A momentary pass does not end a plan: the hold in the fine model does."""
    return weights.success * on_target(s, task)


def r_contact(facts: StepFacts, task: Task, weights: RewardWeights) -> np.ndarray:
    """Contact term: +w for touching the part with progress, -w for touching after success, -w for a collision.

    Repair: the printed condition for the bonus has progress but no contact, and several cases can hold at once;
    here the bonus needs both, progress means one success band nearer to the target, and a collision wins.
    """
    band = task.tolerance / abs(task.s_target - task.s_initial)
    progress = remaining(facts.s, task) < 1.0 - band
    done = on_target(facts.s, task)
    touch = np.where(done, -weights.contact_after, weights.contact * progress)
    return np.where(facts.collides, -weights.collision, touch * facts.touches)


def r_reg(dq: np.ndarray, ddq: np.ndarray, weights: RewardWeights) -> np.ndarray:
    """Regularisation: -sum over the d joints of w_j (w_a |ddq_j| + w_v |dq_j|).

    Repair: absolute values (printed signed, so moving backwards is paid) and d joints instead of d + 1;
    the acceleration is the change of speed over a control step.
    """
    joints = joint_weights(weights, dq.shape[-1])
    return -(np.abs(dq) @ (weights.speed * joints) + np.abs(ddq) @ (weights.acceleration * joints))


def r_calm(ds: np.ndarray, task: Task, weights: RewardWeights) -> np.ndarray:
    """Speed term of the object: -w ds². Not in the paper; the authors' code has -5 |ds|.

    A fast part coasts on when the fingertip stops, by an amount that depends on a friction nobody has measured. The
    square gives a speed that is worth having: a linear term is either too weak or stops all motion.
    """
    return -weights.calm * (1.0 if task.prismatic else 0.04) * ds**2


def r_press(press_N: np.ndarray, weights: RewardWeights) -> np.ndarray:
    """Press term: -w times the force across the part's motion beyond a free one. An addition to the paper.

    Such a force moves nothing. With little friction in the model the fingertip slides along an edge that it jams on in
    truth.
    """
    return -weights.press * np.maximum(press_N - weights.press_free_N, 0.0)


def r_load(load: np.ndarray, weights: RewardWeights) -> np.ndarray:
    """Load term: -w times each joint's servo torque beyond a free share of its limit. An addition to the paper.

    The rollout model does not saturate torques (with limits in it, a long time step makes the arm lag), so nothing
    else keeps a plan from pressing with more than the motors have, which the fine model then cannot follow.
    """
    # A product with ones: the sum over an axis as short as this takes three times as long.
    return -weights.load * (np.maximum(np.abs(load) - weights.load_free, 0.0) @ np.ones(load.shape[-1]))


@functools.cache
def joint_weights(weights: RewardWeights, dof: int) -> np.ndarray:
    """The regularisation's weights for an arm with ``dof`` joints, (dof,)."""
    given = weights.joints[:dof]
    return np.array(given + (weights.joints[-1],) * (dof - len(given)))


def rewards(facts: StepFacts, task: Task, weights: RewardWeights) -> np.ndarray:
    """Value of every rollout, (rollout,): the mean over its steps of the paper's five terms and the three added."""
    total = (
        r_dist(facts.distance_m, facts.turn_rad, weights)
        + r_target(facts.s, task, weights)
        + r_contact(facts, task, weights)
        + r_reg(facts.dq, facts.ddq, weights)
        + r_success(facts.s, task, weights)
        + r_calm(facts.ds, task, weights)
        + r_press(facts.press_N, weights)
        + r_load(facts.load, weights)
    )
    # A product again: mean() takes twice as long.
    return total @ np.full(total.shape[1], 1.0 / total.shape[1])
