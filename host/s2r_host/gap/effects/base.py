"""What every effect of the catalogue provides: regressor or state, seeds, parameters, simulator form."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import ClassVar

import mujoco
import numpy as np

from s2r_host.gap.motion.known_noise import accelerates
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.quantities import SPEED, Quantity
from s2r_host.gap.motion.session import Session

Shape = Mapping[str, float]
USUAL_TURN, FAR_TURN = 0.1, 8.0  # rad, log odds
IMPOSSIBLE = -1e3  # log odds of a size that cannot be


@dataclass(frozen=True)
class Columns:
    """Required effort an effect adds at one shape (its nonlinear parameters).

    Attributes:
        linear: Regressors, each of shape (time,) for one joint or (time, joint) for all of them.
        positive: Per regressor: the coefficient must not be negative.
        fixed: Required effort with a known coefficient of one, same shapes, or None.
        smooth: Per regressor the part of it that was made from the filtered motion alone, as the load of the model is,
            same shapes: it passes the second filter only. Passed through the first once more, the difference of two
            multiples of one acceleration would be a filter, and explain what no effect does. Empty: none has any.
    """

    linear: list[np.ndarray]
    positive: tuple[bool, ...] = ()
    fixed: np.ndarray | None = None
    smooth: tuple[np.ndarray, ...] = ()

    @classmethod
    def of_motion(cls, linear: list[np.ndarray], positive: tuple[bool, ...] = ()) -> Columns:
        """Regressors that are smooth throughout."""
        return cls(linear, positive, smooth=tuple(linear))


@dataclass(frozen=True)
class Value:
    """A number with unit; ``gradient`` is its derivative by the linear coefficients, for the interval.

    ``error`` is one deviation of what the equation leaves out, in the unit of the value.
    """

    value: float
    unit: str
    gradient: tuple[float, ...] = ()
    shape_key: str | None = None
    scale: float = 1.0
    error: float = 0.0


@dataclass
class Context:
    """What effects may look at: the model and the sessions that may be fitted.

    Attributes:
        residual: Residual effort on the work grid per (session, joint), smooth motion shapes regressed out.
        control_lag: Per joint: lag of the recorded position behind the one the controller used, and its
            uncertainty [s]; absent when the control law is not known.
        given: What an effect's ``given`` took from model and recordings, where there are none (``patch.py``).
    """

    model: RigidModel
    sessions: list[Session]
    residual: dict[tuple[int, int], np.ndarray] = field(default_factory=dict)
    control_lag: dict[int, tuple[float, float]] = field(default_factory=dict)
    given: dict[str, list[float]] = field(default_factory=dict)

    def span(self, joint: int) -> tuple[float, float]:
        """Smallest and largest position over all sessions."""
        return (
            min(float(s.q[:, joint].min()) for s in self.sessions),
            max(float(s.q[:, joint].max()) for s in self.sessions),
        )

    def top_speed(self, joint: int) -> float:
        """Largest speed over all sessions (99.5 percentile)."""
        return max(float(np.percentile(np.abs(s.v[:, joint]), 99.5)) for s in self.sessions)

    def accelerates(self, joint: int) -> bool:
        """Does any session tell this joint's acceleration from the noise of its channel?"""
        return any(accelerates(self.model, s, joint) for s in self.sessions)

    def turns(self, joint: int) -> int:
        """Reversals of direction over all sessions, chatter inside the velocity noise left out."""
        return sum(count_reversals(s, joint) for s in self.sessions)

    def both_ways(self, joint: int) -> bool:
        """The joint goes there and back: within a session, or in two of single strokes."""
        ways = {float(np.sign(s.q[-1, joint] - s.q[0, joint])) for s in self.sessions}
        return self.turns(joint) >= 2 or {-1.0, 1.0} <= ways


def count_reversals(s: Session, joint: int) -> int:
    """Changes of direction between clear motions."""
    v = s.v[:, joint]
    clear = v[np.abs(v) > 3.0 * s.v_eps[joint]]
    return int(np.sum(np.diff(np.sign(clear)) != 0)) if clear.size else 0


@dataclass
class StepState:
    """What an effect sees at one step of the forward simulation; arrays in joint order.

    Attributes:
        t: Time [s].
        q, v, a: Position, velocity, acceleration.
        u: Effort asked of the drives [N·m or N].
        pushed: Effort of what else acts on the bodies, a wrench [N·m or N].
        load: Effort that arrived in the step before, contacts included [N·m or N].
    """

    t: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    u: np.ndarray
    pushed: np.ndarray
    load: np.ndarray


# Effort an effect takes away from its joint, and dry friction it adds. The latter goes to the solver's friction loss,
# which is implicit and does not chatter.
Runtime = Callable[[StepState], tuple[float, float]]


class Effect:
    """Base of all effects. Subclasses fill the class attributes and ``columns``."""

    name: ClassVar[str]
    equation: ClassVar[str]
    separating_motion: ClassVar[str]
    signature: ClassVar[str] = ""
    kind: ClassVar[str] = "physics"
    side: ClassVar[str] = "plant"
    scope: ClassVar[str] = "joint"
    confusable: ClassVar[tuple[str, ...]] = ()
    part_is: ClassVar[str] = ""
    foreign_is: ClassVar[str] = ""
    contains: ClassVar[tuple[str, ...]] = ()
    shows_over: ClassVar[Quantity] = SPEED  # over which the report draws the residual that it explains
    explained_least: ClassVar[float] = 1.0
    # Relative error (one deviation) of a parameter beyond its noise where the equation is known to be coarse; read from
    # tuning sets. From 0.5 on the parameter is not identifiable.
    model_error: ClassVar[dict[str, float]] = {}
    simulated_by_mean: ClassVar[bool] = False  # one joint's simulation has a mean for what the effect follows
    costly: ClassVar[bool] = False  # shapes are refined only when a seed beats having no effect at all

    def applies(self, ctx: Context, joint: int) -> bool:
        """Can this effect act on this joint at all, given model and channels?"""
        return True

    def blocked(self, ctx: Context, joint: int) -> str | None:
        """Why the excitation cannot show this effect, or None."""
        return None

    def shown_over(self, shape: Shape) -> Quantity:
        """Over which quantity an effect of this shape shows."""
        return self.shows_over

    def shapes(self, ctx: Context, joint: int) -> list[dict[str, float]]:
        """Seeds for the nonlinear parameters; one empty map when there are none."""
        return [{}]

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Required effort per unit coefficient along a session."""
        raise NotImplementedError

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Log odds of this size, before the data: wrong numbers are small, added physics is not."""
        return 0.0

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Physical parameters from shape and coefficients."""
        raise NotImplementedError

    def brings(
        self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray
    ) -> dict[str, tuple[float, ...]]:
        """Simpler effects that this one holds because the model lacks them: name -> weights of the coefficients.

        The weighted sum is their size; weights that are not given are zero.
        """
        return {}

    def part(
        self, ctx: Context, s: Session, joint: int, shape: Shape, theta: np.ndarray
    ) -> np.ndarray | None:
        """A physically distinct part of the required effort, as large as the whole says; None when there is only one.

        Another cause may imitate the sum of the parts, but not their ratio. ``part_is`` says what it is.
        """
        return None

    def foreign(
        self, ctx: Context, s: Session, joint: int, shape: Shape, theta: np.ndarray
    ) -> np.ndarray | None:
        """What an imitator would add, as large as the effect itself: (time,) or (time, k); None when none is known.

        Beside the true effect nothing of it is left. ``foreign_is`` says what it is.
        """
        return None

    def refine(self, ctx: Context, joint: int) -> dict[str, tuple[str, float]]:
        """Shape parameters worth refining: key -> (``log`` or ``linear``, first step)."""
        return {}

    def bounds(self, ctx: Context, joint: int) -> dict[str, tuple[float, float]]:
        """Limits of shape parameters during refinement."""
        return {}

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """What other equations than the plant's say about this shape, as log odds (0 says nothing)."""
        return 0.0

    def runtime(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray, dt: float) -> Runtime | None:
        """Per-step form for the forward simulation; None when ``patch`` covers it."""
        return None

    def given(self, ctx: Context, joint: int, shape: Shape) -> dict[str, list[float]]:
        """What the per-step form takes from model and recordings, which ``patch.py`` does not have; mostly nothing."""
        return {}

    def patch(self, ctx: Context, spec: mujoco.MjSpec, joint: int, shape: Shape, theta: np.ndarray) -> bool:
        """Write the effect into a model with stock attributes; False when there is no such form."""
        return False

    def mirror(self, joint: int, shape: Shape) -> tuple[int, dict[str, float]] | None:
        """The other joint on which the same numbers act in the forward simulation, and its shape; None mostly."""
        return None

    def sense(
        self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray
    ) -> Callable[[float], float] | None:
        """What the sensor of this joint reports for a true position; None when it reports the truth."""
        return None


def small_is_odd(share: float) -> float:
    """Log odds for physics as small as the error of a nominal value."""
    return -4.0 if abs(share) < 0.06 else 0.0


def turned(angle: float, width: float) -> float:
    """Log odds of a zero turned by so much [rad], where ``width`` is the usual error of such a zero.

    On one joint a tilted base and a shifted encoder fit alike: what decides is which of them errs by so much.
    """
    return float(np.log(USUAL_TURN / width)) - min(FAR_TURN, 0.5 * (angle / width) ** 2)


def as_written(spec: mujoco.MjSpec, joint: mujoco.MjsJoint, x: float) -> float:
    """A position of a joint [rad or m] in the unit of the file that the model was read from: degrees, if so."""
    turns = joint.type == mujoco.mjtJoint.mjJNT_HINGE
    return float(np.rad2deg(x)) if turns and spec.compiler.degree else x


def free_name(wanted: str, elements: Sequence[mujoco.MjsElement]) -> str:
    """A name that none of the elements has: that of an earlier patch may stand in the model."""
    taken = {one.name for one in elements}
    return next(x for x in (f"{wanted}{k or ''}" for k in count()) if x not in taken)
