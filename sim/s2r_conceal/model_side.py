"""What the model file of a case has built in, and what it has wrong: drawn apart from what is hidden.

Were springs, clips and tilts built in only where nothing is hidden, a file with one of them would say so before its
recordings are looked at.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from s2r_conceal.effects.table import PARAMETER_LIKE
from s2r_conceal.masks import Mask
from s2r_conceal.parameters import Machine, Scale
from s2r_conceal.plant import Active
from s2r_conceal.shapes import open_effect

SHARE = 0.25  # of the cases, of whatever group
IN_SIGHT = ("gravity_tilt", "spring_return", "saturation")  # the file shows that something is built in
AS_NUMBERS = ("armature", "payload", "coulomb_friction")  # the file shows a number as any other
VALUES = ("mass", "com", "inertia", "armature", "viscous", "coulomb", "controller_gain")
WIDE = -1.0  # reduction of a clip that no motion reaches


def built_in(
    rng: np.random.Generator, group: str, variant: str, hidden: list[Active], scales: list[Scale]
) -> list[Active]:
    """At most one effect that machine and model file have alike, and never the hidden one again on its joint.

    What a file shows is as frequent in every group and variant; ``in_model`` has something in every case.
    """
    names = IN_SIGHT if rng.random() < SHARE else AS_NUMBERS if variant == "in_model" else ()
    taken = {(active.name, active.joint) for active in hidden}
    free = [a for a in (open_effect(rng, name, scales) for name in names) if (a.name, a.joint) not in taken]
    return [_as_a_file_says(free[rng.integers(len(free))], group)] if free else []


def _as_a_file_says(active: Active, group: str) -> Active:
    """A clip without a speed slope; where the motion is to show nothing, one that does not act."""
    if active.name != "saturation":
        return active
    wide = {"reduction": WIDE} if group == "insufficient" else {}
    return replace(active, values=active.values | {"no_load_speed": 1e9} | wide)


def wrong_values(
    rng: np.random.Generator, group: str, variant: str, hidden: list[Active], machine: Machine, mask: Mask
) -> list[dict[str, float | str]]:
    """At most one wrong value in the model file or in the stated controller; calibration sets its size.

    Beside a hidden effect that is such a value itself nobody could tell the two apart, without effort it would be one
    more thing that positions do not show, and a motion that shows nothing hides it, too.
    """
    asked = rng.random() < SHARE and group not in ("clean", "insufficient", "wrong_log")
    if mask.no_effort or any(active.name in PARAMETER_LIKE for active in hidden):
        asked = False
    if not asked and variant != "parameter_off":
        return []
    names = [n for n in VALUES if n not in ("viscous", "coulomb", "armature") or getattr(machine, n)[0] > 0.0]
    if mask.no_law:
        names.remove("controller_gain")
    return [
        {
            "name": str(rng.choice(names)),
            "joint": int(rng.integers(len(machine.mass))),
            "relative": float(rng.choice([-1.0, 1.0])) * 0.1,
            "target": float(rng.choice([4.0, 10.0])),
        }
    ]
