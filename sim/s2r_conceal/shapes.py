"""An effect before its size is set: the joint it sits on and its shape."""

from __future__ import annotations

import numpy as np

from s2r_conceal.effects.table import EFFECTS
from s2r_conceal.parameters import Scale
from s2r_conceal.plant import Active


def open_effect(rng: np.random.Generator, name: str, scales: list[Scale]) -> Active:
    """An effect with joint and shape drawn and its size in the middle of what is plausible."""
    effect, joint = EFFECTS[name], _place(rng, name, len(scales))
    scale = scales[joint]
    shape = effect.draw(rng, scale)
    low, high = effect.sizes(scale, shape)
    middle = float(np.sqrt(low * high)) if low > 0.0 else 0.5 * (low + high)
    return Active(name, joint, shape | {effect.size: middle})


def _place(rng: np.random.Generator, name: str, joints: int) -> int:
    """The joint an effect sits on: a load hangs on the last one, the base carries the first one."""
    first = 1 if name == "motor_coupling" else 0  # a joint and the one before it
    return {"payload": joints - 1, "gravity_tilt": 0}.get(name, int(rng.integers(first, joints)))
