"""Base parameters as explanations of their own: a wrong number in a right structure."""

from __future__ import annotations

import numpy as np

from s2r_host.gap.effects.base import IMPOSSIBLE, Columns, Context, Effect, Shape, Value
from s2r_host.gap.motion.session import Session
from s2r_host.gap.regression.nuisance import COMPARISON, BaseParameter

PREFIX = "parameter:"
SKIPPED = (*COMPARISON, "damping", "frictionloss")  # friction has effects of its own name
USUAL, USUAL_ZERO = 0.06, 0.01  # of a value; of the deviation of an effort from its mean
FAR = 8.0  # log odds
MULTIPLE = 25.0  # the same against a body of more than twice its stated inertia: a motor has been left out
NEVER_NEGATIVE = ("mass", "inertia", "armature", "damping", "frictionloss", "payload_mass")
LEAST_ARM = 0.02  # of the body's size: a centre nearer to the origin has no direction


class BaseTerm(Effect):
    """One base parameter (or the three coordinates of a centre of mass) with a wide prior."""

    kind = "parameter"
    scope = "model"
    equation = "a parameter of the nominal model"
    separating_motion = "poses and speeds over the whole workspace"

    def __init__(self, name: str, members: list[BaseParameter]) -> None:
        self.name = name  # type: ignore[misc]
        self.members = members

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Required effort per unit of each member.

        These pass both filters like anything else: at the upper end of a band that a line of the effort widened, what a
        coarse encoder says of the acceleration is no measure of an inertia.
        """
        return Columns([m.column(s) for m in self.members])

    def log_prior(self, ctx: Context, joint: int, shape: Shape) -> float:
        """An acceleration that is noise tells no inertia of a motor."""
        motors = [ctx.model.index(m.place) for m in self.members if m.name == "armature"]
        return 0.0 if all(ctx.accelerates(j) for j in motors) else IMPOSSIBLE

    def size_prior(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> float:
        """Nominal values are rarely off by more than 5 %, the zero of an effort by more than 1 % of its swing.

        No mass, inertia or friction is below zero: a body's small inertia cannot make up for a motor's large one.
        """
        multiple = 0.0
        for member, move in zip(self.members, self.moves(theta), strict=True):
            to = member.nominal + float(move) * member.size
            if member.name in NEVER_NEGATIVE and to < 0.0:
                return IMPOSSIBLE
            if member.name == "inertia" and to > 2.0 * member.nominal:
                multiple = MULTIPLE
        usual = np.array([_usual(ctx, m) for m in self.members[: len(theta)]])
        return -multiple - min(FAR, 0.5 * float(np.max(np.abs(theta) / usual, initial=0.0)) ** 2)

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Members in their own units."""
        found = {}
        for i, m in enumerate(self.members):
            gradient = [0.0] * len(theta)
            gradient[i] = m.size
            found[m.name] = Value(m.nominal + float(theta[i]) * m.size, m.unit, tuple(gradient))
        return found

    def moves(self, theta: np.ndarray) -> np.ndarray:
        """Change of every member in its own unit of size, shape (members,)."""
        return theta


class CentreDistance(BaseTerm):
    """A centre of mass nearer to the body's origin than stated, or further: its direction stays.

    A centre that leaves its direction turns about the joint; on one joint that is a turned zero, which has names of its
    own. One number here, whatever frame the body's coordinates are written in.
    """

    def __init__(self, name: str, members: list[BaseParameter]) -> None:
        super().__init__(name, members)
        nominal = np.array([m.nominal for m in members])
        self.direction = nominal / float(np.linalg.norm(nominal))

    def columns(self, ctx: Context, s: Session, joint: int, shape: Shape) -> Columns:
        """Required effort per unit of size along the centre's direction."""
        return Columns(
            [np.sum([d * m.column(s) for d, m in zip(self.direction, self.members, strict=True)], axis=0)]
        )

    def parameters(self, ctx: Context, joint: int, shape: Shape, theta: np.ndarray) -> dict[str, Value]:
        """Coordinates, which move together."""
        return {
            m.name: Value(m.nominal + float(theta[0]) * d * m.size, m.unit, (d * m.size,))
            for d, m in zip(self.direction, self.members, strict=True)
        }

    def moves(self, theta: np.ndarray) -> np.ndarray:
        """Along the direction."""
        return float(theta[0]) * self.direction


def _usual(ctx: Context, m: BaseParameter) -> float:
    """Error that a base parameter usually has, in its own unit of size."""
    if m.name != "effort_offset":
        return USUAL
    j = ctx.model.index(m.place)
    swings = [float(np.std(s.u[:, j])) for s in ctx.sessions if s.has_u[j]]
    return USUAL_ZERO * max(swings, default=0.0) / m.size or USUAL


def with_directions_held(terms: dict[str, BaseTerm]) -> dict[str, BaseTerm]:
    """The same explanations with centres of mass that keep their direction, where they have one."""
    return {
        name: CentreDistance(name, term.members)
        if name.startswith(f"{PREFIX}com") and any(abs(m.nominal) > LEAST_ARM * m.size for m in term.members)
        else term
        for name, term in terms.items()
    }


def base_terms(parameters: list[BaseParameter]) -> dict[str, BaseTerm]:
    """Explanations by name: ``parameter:mass@arm``, ``parameter:com@arm``, ..."""
    found: dict[str, BaseTerm] = {}
    for p in parameters:
        if p.name in SKIPPED:
            continue
        short = p.name.split("_")[0]
        name = f"{PREFIX}{short}@{p.place}"
        if name in found:
            found[name].members.append(p)
        else:
            found[name] = BaseTerm(name, [p])
    return found
