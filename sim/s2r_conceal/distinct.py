"""What of an effect wrong values could not also explain: its strength after their small changes are projected out.

An effect whose ``distinct`` is below one cannot be told from wrong parameters by anyone.  Without effort the gains of
the loop are not told either, so that in position they explain as much as they can, too.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from s2r_conceal.cases import Case
from s2r_conceal.effects.table import PARAMETER_LIKE
from s2r_conceal.parameters import Machine
from s2r_conceal.plant import Trace
from s2r_conceal.strength import Measured, Sought, runs, runs_of, signals, size_of

POSITION = slice(0, 1)  # among the channels


def measure(sought: Sequence[Sought], measured: Sequence[Measured]) -> None:
    """Fill strength, its position part and the parts that no parameter change explains."""
    machines = [_machines(s) for s in sought]
    loops = [_loops(s) for s in sought]
    varied = [case for group in [*machines, *loops] for case in group]
    owners = [s for s, group in zip([*sought, *sought], [*machines, *loops], strict=True) for _ in group]
    traces = iter(runs(varied, [s.beside for s in owners], [s.span for s in owners]))
    bases = [[_change(s, next(traces)) for _ in group] for s, group in zip(sought, machines, strict=True)]
    gains = [[_change(s, next(traces)) for _ in group] for s, group in zip(sought, loops, strict=True)]
    changed = runs_of(sought, [s.active for s in sought])
    for s, m, trace, basis, loop in zip(sought, measured, changed, bases, gains, strict=True):
        difference = _change(s, trace)
        m.strength[s.k] = size_of(difference)
        m.strength_q[s.k] = size_of(difference[POSITION])
        m.distinct[s.k] = size_of(_left_over(difference, basis))
        if loop:
            m.distinct_q[s.k] = size_of(
                _left_over(difference[POSITION], [b[POSITION] for b in [*basis, *loop]])
            )


def _change(sought: Sought, trace: Trace) -> np.ndarray:
    """What another run of the case differs by, in floors."""
    case, floor = sought.case, sought.floor
    return signals(case, trace, floor) - signals(case, sought.without, floor)


def _machines(sought: Sought) -> list[Case]:
    """The case with machines that differ a little in one value each; none where the effect is such a value itself."""
    case, active = sought.case, sought.active
    if active.name in PARAMETER_LIKE:
        return []
    return [replace(case, machine=machine) for machine in _variations(case, active.joint, active.name)]


def _variations(case: Case, joint: int, name: str) -> list[Machine]:
    """Machines that differ a little in one value each; values the effect itself stands for are left out."""
    m, found = case.machine, []
    length = float(np.linalg.norm(m.com[joint])) or 0.1
    for axis in (0, 2) if case.rig.joints < 3 else (0, 1, 2):
        com = m.com.copy()
        com[joint, axis] += 0.01 * length
        found.append(replace(m, com=com))
    for field, factor in (("mass", 0.01), ("inertia", 0.03), ("armature", 0.03)):
        value = getattr(m, field).copy()
        value[joint] = value[joint] * (1.0 + factor)
        found.append(replace(m, **{field: value}))
    for field, own in (("viscous", "viscous_friction"), ("coulomb", "coulomb_friction")):
        value = getattr(m, field).copy()
        if name != own and value[joint] > 0.0:
            value[joint] *= 1.05
            found.append(replace(m, **{field: value}))
    return found


def _loops(sought: Sought) -> list[Case]:
    """Where effort is not recorded: the case under loops that differ a little in one gain or in what is fed forward."""
    case, joint = sought.case, sought.active.joint
    if not case.mask.no_effort:
        return []
    found = []
    for gain in ("kp", "kd", "ki"):
        value = getattr(case.controller, gain).copy()
        value[joint] *= 1.05
        found.append(replace(case, controller=replace(case.controller, **{gain: value})))
    fed = {role: replace(motion, tau_ff=0.95 * motion.tau_ff) for role, motion in case.motions.items()}
    return [*found, replace(case, motions=fed)] if case.feed_forward else found


def _left_over(difference: np.ndarray, basis: list[np.ndarray]) -> np.ndarray:
    """What remains of a difference after the best combination of those in the basis."""
    finite = [b.ravel() for b in basis if np.isfinite(b).all()]
    if not finite or not np.isfinite(difference).all():
        return difference
    A = np.stack(finite, axis=1)
    A = A / np.maximum(np.linalg.norm(A, axis=0), 1e-12)
    solution, *_ = np.linalg.lstsq(A, difference.ravel(), rcond=1e-6)
    return difference - (A @ solution).reshape(difference.shape)
