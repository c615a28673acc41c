"""Motions of a small part found by sampling the evidence itself, where following surfaces downhill leads astray.

A few hundred pixels of a lever let Gauss-Newton settle on a turn that puts surface onto any surface. The evidence, what
left and what appeared included, knows better, but has no slopes. The cross-entropy method (Rubinstein 1999) needs none:
draw motions about the best so far, keep the best of them, narrow down.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.evidence import Probe, Scene, probe, score
from s2r_host.perception.levers import Column
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.refine import perturbed

Array = NDArray[np.floating]

SPREAD = np.array([np.radians(5), np.radians(5), 0.010, 0.010, np.radians(4)])  # as `refine.perturbed` counts
ROUNDS, DRAWN, KEPT = 6, 64, 8
FEW_POINTS = 300
COARSE_M, FINE_M = 0.004, 0.001
STARTS, COLUMNS, PER_COLUMN = 3, 2, 2
TURNS_RAD = np.radians(np.arange(4.0, 64.0, 4.0))


def sampled(
    starts: Sequence[JointMotion], columns: Sequence[Column], scene: Scene, rng: np.random.Generator
) -> list[JointMotion]:
    """What sampling makes of the best motions so far, and of turns about the round bodies beside the part.

    Args:
        starts: Motions, best first; hinges among the first few are taken.
        columns: Lines that the part may turn about; the surely round ones are taken.
        scene: Both views.
        rng: Of the samples.
    """
    probes = (
        probe(scene.before, scene.moved_before(), FEW_POINTS, rng),
        probe(scene.after, scene.moved_after(), FEW_POINTS, rng),
    )
    middle = np.median(np.concatenate([one.points for one in probes]), axis=0)
    chosen = [motion for motion in starts[:STARTS] if motion.joint_type == "revolute"]
    for column in [one for one in columns if one.sure][:COLUMNS]:
        turns = [
            JointMotion("revolute", column.centre, sense * column.direction, turn)
            for sense in (1.0, -1.0)
            for turn in TURNS_RAD.tolist()
        ]
        best = np.argsort(score(turns, scene, *probes, extra_m=COARSE_M), kind="stable")[:PER_COLUMN]
        chosen += [turns[int(k)] for k in best]
    return [_settled(_beside(motion, middle), scene, probes, rng) for motion in chosen]


def _beside(motion: JointMotion, p: Array) -> JointMotion:
    """The same motion with its origin beside a point (3,): tilts then hardly shift what is there."""
    along = float((p - motion.origin) @ motion.direction)
    return JointMotion("revolute", motion.origin + along * motion.direction, motion.direction, motion.delta)


def _settled(
    motion: JointMotion, scene: Scene, probes: tuple[Probe, Probe], rng: np.random.Generator
) -> JointMotion:
    """The mean of the best samples about a motion, after some rounds."""
    mean, spread = np.zeros(5), SPREAD
    for _ in range(ROUNDS):
        steps = mean + rng.normal(size=(DRAWN, 5)) * spread
        steps[0] = mean
        cost = score([perturbed(motion, step) for step in steps], scene, *probes, extra_m=FINE_M)
        elite = steps[np.argsort(cost, kind="stable")[:KEPT]]
        mean, spread = elite.mean(axis=0), 0.5 * (spread + elite.std(axis=0))
    return perturbed(motion, mean).positive()
