"""What one effect consists of: how it is drawn, how large it may be, and how it acts.

A hook lives on flat indices ``idx`` of the plant's state and holds one array per parameter.  It implements
any of the stages below and keeps ``contribution``, the size of what it does, from which the truth about
"when and where" is read.

| stage | called | may change |
|---|---|---|
| ``drive(s)`` | every step | ``s.u_drive``, ``s.u_report`` |
| ``force(s)`` | every step | ``s.f_motor``, ``s.f_link``, ``s.inertia_extra``, velocities on impact |
| ``friction(s)`` | every step | ``s.bound_plus``, ``s.bound_minus``, ``s.f_motor`` |
| ``transmit(s, motor)`` | every step | ``motor``: torque that reaches the load |
| ``sense(s, q, dq)`` | every control tick | measured position and velocity, in place |
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from s2r_conceal.parameters import Machine, Scale
from s2r_conceal.plant import State, Trace

Draw = Callable[[np.random.Generator, Scale], dict[str, float]]


class Hook:
    """Base of all hooks: parameters of every instance as attributes of shape (instances,)."""

    order: ClassVar[int] = 50

    def __init__(self, idx: np.ndarray, values: dict[str, np.ndarray], state: State) -> None:
        self.idx = idx
        self.owners: list[tuple[int, int]] = []
        self.contribution = np.zeros(idx.size)
        self.p = values
        self.begin(state)

    def begin(self, s: State) -> None:
        """Prepare internal states."""


@dataclass(frozen=True)
class Effect:
    """One entry of the catalogue, or one family outside it.

    Attributes:
        name: Contract name; families outside the catalogue have names of their own.
        hook: How it acts over time; None for what only alters the machine or the log.
        draw: Shape parameters for a joint of this scale.
        size: The parameter that sets the strength.
        sizes: Smallest and largest plausible size for a drawn shape.
        units: Parameter name → unit, for the answer file.
        words: Regime in words.
        known: Whether the catalogue has it.
        same_as: Equivalence class declared by the contract, without the name itself.
        min_joints: Smallest rig that can show it.
        needs: Machine properties it needs: ``coulomb``, ``armature``.
        for_role: Changes the values per recording role (fit, repeat, holdout).
        machine: Changes the rigid-body parameters.
        log: Changes the recorded channels after the run.
        trace: Contribution read from the finished recording, for effects that have no hook.
    """

    name: str
    draw: Draw
    size: str
    sizes: Callable[[Scale, dict[str, float]], tuple[float, float]]
    units: dict[str, str]
    words: str
    hook: type[Hook] | None = None
    known: bool = True
    same_as: tuple[str, ...] = ()
    min_joints: int = 1
    needs: tuple[str, ...] = ()
    for_role: Callable[[dict[str, float], str], dict[str, float]] | None = None
    machine: Callable[[Machine, int, dict[str, float], Any], Machine] | None = None
    log: Callable[[Trace, int, dict[str, float]], None] | None = None
    trace: Callable[[Trace, int, dict[str, float]], np.ndarray] | None = None


def sign(rng: np.random.Generator) -> float:
    """Plus or minus one."""
    return float(rng.choice([-1.0, 1.0]))


def log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """A draw whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))
