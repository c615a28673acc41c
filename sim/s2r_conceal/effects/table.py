"""All effects by name, and how the columns of one simulation turn into hooks."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

import numpy as np

from s2r_conceal.effects import drive, friction, inertia, position, sensing, transmission, unknown
from s2r_conceal.effects.base import Effect, Hook
from s2r_conceal.parameters import Machine
from s2r_conceal.plant import Active, Column, State, Trace
from s2r_conceal.rigs.base import Rig

EFFECTS: dict[str, Effect] = {
    effect.name: effect
    for module in (friction, transmission, drive, sensing, position, inertia, unknown)
    for effect in module.EFFECTS
}
KNOWN: tuple[str, ...] = tuple(name for name, effect in EFFECTS.items() if effect.known)
UNKNOWN: tuple[str, ...] = tuple(name for name, effect in EFFECTS.items() if not effect.known)

# Effects that are a wrong value of the model file, the torque constant or the encoder's zero, or work as one does.
PARAMETER_LIKE: tuple[str, ...] = ("payload", "armature", "effort_scale", "gravity_tilt", "encoder_offset")

# Names of the contract that need an articulated part in the arm's hand; they come with the arm-and-object rigs.
NEEDS_OBJECT: tuple[str, ...] = ("joint_play", "flexible_part", "contact_slip")


def altered_machine(rig: Rig, machine: Machine, effects: Sequence[Active]) -> Machine:
    """The machine after the effects that live in its rigid bodies."""
    for active in effects:
        change = EFFECTS[active.name].machine
        if change is not None:
            machine = change(machine, active.joint, active.values, rig)
    return machine


def build_hooks(columns: Sequence[Column], state: State) -> list[Hook]:
    """One hook per kind of effect, on all flat indices where it is at work, in stage order."""
    members: dict[str, list[tuple[int, int, Active]]] = defaultdict(list)
    for c, column in enumerate(columns):
        for position_, active in enumerate(column.effects):
            if EFFECTS[active.name].hook is not None:
                members[active.name].append((c, position_, active))
    kinds = {name: kind for name in EFFECTS if name in members and (kind := EFFECTS[name].hook) is not None}
    hooks = []
    # They begin in the order in which they act: a motor stands where an offset of the encoder has put its load.
    for name, kind in sorted(kinds.items(), key=lambda item: item[1].order):
        group = members[name]
        idx = np.array([c * state.joints + active.joint for c, _, active in group])
        values = {k: np.array([active.values[k] for _, _, active in group]) for k in group[0][2].values}
        hook = kind(idx, values, state)
        hook.owners = [(c, position_) for c, position_, _ in group]
        hooks.append(hook)
    return hooks


def finish_log(trace: Trace, effects: Sequence[Active]) -> Trace:
    """Apply what happens between machine and file, and fill contributions of effects without a hook."""
    for k, active in enumerate(effects):
        effect = EFFECTS[active.name]
        if effect.trace is not None:
            trace.contributions[k] = effect.trace(trace, active.joint, active.values).astype(np.float32)
        if effect.log is not None:
            effect.log(trace, active.joint, active.values)
    return trace
