"""Postures of the whole arm among the scene's geoms: which touch something, many at a time, without physics.

Links of the arm touch each other from as far apart as the executor wants them: it would refuse what lets them nearer.
"""

from __future__ import annotations

import copy
from itertools import pairwise

import mujoco
import numpy as np

from s2r_host.planning.contact_count import ContactCount
from s2r_host.planning.scene import GeomKind, Scene
from s2r_protocol.arms.clearance import SHAPE_INFLATION_M

_ARM_BIT, _FINGER_BIT = 1, 2
STEP_RAD = 0.06  # between postures that are looked at along a line
FINE_STEP_RAD = 0.02  # the same where a way is to be gone: no bar is stepped over


class FreeSpace:
    """Says where the robot touches something, at postures of the arm and states of the object."""

    def __init__(
        self,
        scene: Scene,
        threads: int,
        margin_m: float = 0.0,
        others: np.ndarray | None = None,
        *,
        rims: bool = False,
    ) -> None:
        """Args: scene; threads; ``margin_m``, distance that counts as a contact already, but of fingertip and part.

        ``others`` are the positions of everything besides the arm, (nq - dof,); None: as the file has them.
        With ``rims`` the robot touches the part wherever it may reach to.
        """
        self._dof, self._s = scene.dof, scene.s_qpos
        more = [_of_links(scene, threads)]
        if margin_m > 0.0:
            more.append(_of_fingers(scene, threads, margin_m))
        self._all, self._touching = (
            [_of_robot(scene, threads, margin_m, touching=touching, rims=rims), *more]
            for touching in (False, True)
        )
        self._qpos0 = scene.fine.qpos0.copy()
        if others is not None:
            self._qpos0[scene.dof :] = others

    def touches(self, q: np.ndarray, s: float | np.ndarray, *, touching: bool = False) -> np.ndarray:
        """Whether the robot touches something, (n,), at postures q (n, dof) with the object's joint at s.

        With ``touching`` the fingers may touch the part.
        """
        rows = np.tile(self._qpos0, (len(q), 1))
        rows[:, : self._dof] = q
        rows[:, self._s] = s
        hit = np.zeros(len(q), dtype=bool)
        for count in self._touching if touching else self._all:
            left = np.flatnonzero(~hit)
            hit[left] = count.at(rows[left]) > 0
        return hit

    def blocked_share(self, q_from: np.ndarray, q_to: np.ndarray, s: float, count: int = 10) -> np.ndarray:
        """Share of the straight lines from one posture to several (n, dof) that touches something, (n,)."""
        share = (np.arange(count) + 1.0) / (count + 1.0)
        points = q_from + share[None, :, None] * (q_to[:, None] - q_from)
        hits = self.touches(points.reshape(-1, q_to.shape[1]), s)
        return hits.reshape(len(q_to), count).mean(axis=1)

    def path_is_free(self, q_path: np.ndarray, s: float, step_rad: float = STEP_RAD) -> bool:
        """True if nothing is touched along a polyline (n, dof), looked at every ``step_rad``."""
        points = [q_path[:1]]
        for a, b in pairwise(q_path):
            count = max(1, int(np.ceil(np.abs(b - a).max() / step_rad)))
            points.append(a + (np.arange(1, count + 1) / count)[:, None] * (b - a))
        return not self.touches(np.concatenate(points), s).any()


def _of_robot(scene: Scene, threads: int, margin_m: float, *, touching: bool, rims: bool) -> ContactCount:
    """Contacts that the robot has with anything else; with ``touching``, fingers against the part have none."""
    kind = scene.geom_kind
    robot, finger = kind >= GeomKind.ROBOT, kind == GeomKind.FINGER
    solid = (scene.solid | scene.rims if rims else scene.solid) & ~robot
    model = _without_contacts(scene)
    model.geom_contype[robot] = np.where(finger[robot], _FINGER_BIT, _ARM_BIT)
    model.geom_conaffinity[solid] = _ARM_BIT | _FINGER_BIT
    if touching:
        model.geom_conaffinity[solid & (kind == GeomKind.PART)] = _ARM_BIT
    _keep_apart(model, robot & ~finger, margin_m)
    return ContactCount(model, threads)


def _of_links(scene: Scene, threads: int) -> ContactCount:
    """Contacts of the arm's links with each other, all made as much thicker as admission makes them.

    Of two boxes askew MuJoCo tells the distance only roughly; :class:`LinksApart` has the last word on a motion.
    """
    robot = scene.geom_kind >= GeomKind.ROBOT
    model = _without_contacts(scene)
    model.geom_contype[robot] = model.geom_conaffinity[robot] = _ARM_BIT
    # What may touch its neighbour is excluded by name. The gripper is none of the link before the last.
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_FILTERPARENT
    _keep_apart(model, robot, SHAPE_INFLATION_M)
    return ContactCount(model, threads)


def _of_fingers(scene: Scene, threads: int, margin_m: float) -> ContactCount:
    """Contacts that the fingers have with what is neither robot nor part.

    On its own because the margins of two geoms add up: the robot would have to keep twice as far from there.
    """
    kind = scene.geom_kind
    finger = kind == GeomKind.FINGER
    around = scene.solid & (kind < GeomKind.ROBOT) & (kind != GeomKind.PART)
    model = _without_contacts(scene)
    model.geom_contype[finger] = _FINGER_BIT
    model.geom_conaffinity[around] = _FINGER_BIT
    _keep_apart(model, finger, margin_m)
    return ContactCount(model, threads)


def _without_contacts(scene: Scene) -> mujoco.MjModel:
    model = copy.copy(scene.fine)
    model.geom_contype[:] = 0
    model.geom_conaffinity[:] = 0
    return model


def _keep_apart(model: mujoco.MjModel, geoms: np.ndarray, margin_m: float) -> None:
    """Let geoms (n,) have contacts from a distance on; their bodies' margins are what the broad phase goes by."""
    model.geom_margin[geoms] = margin_m
    bodies = np.unique(model.geom_bodyid[geoms])
    model.body_margin[bodies] = np.maximum(model.body_margin[bodies], margin_m)
