"""Postures of the whole arm among the scene's geoms: which touch something, many at a time, without physics."""

from __future__ import annotations

import copy
from itertools import pairwise

import mujoco
import numpy as np

from s2r_host.planning.contact_count import ContactCount
from s2r_host.planning.scene import GeomKind, Scene

_ARM_BIT, _FINGER_BIT = 1, 2
STEP_RAD = 0.06  # between postures that are looked at along a line
FINE_STEP_RAD = 0.02  # the same where a way is to be gone: no bar is stepped over


class FreeSpace:
    """Counts the robot's contacts at postures of the arm and states of the object."""

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
        robot = [
            _of_robot(scene, threads, margin_m, touching=touching, rims=rims) for touching in (False, True)
        ]
        fingers = [_of_fingers(scene, threads, margin_m)] if margin_m > 0.0 else []
        self._all, self._touching = ([count, *fingers] for count in robot)
        self._qpos0 = scene.fine.qpos0.copy()
        if others is not None:
            self._qpos0[scene.dof :] = others

    def contacts(self, q: np.ndarray, s: float | np.ndarray, *, touching: bool = False) -> np.ndarray:
        """Number of contacts, (n,), at postures q (n, dof) with the object's joint at s; see ``touching`` above."""
        rows = np.tile(self._qpos0, (len(q), 1))
        rows[:, : self._dof] = q
        rows[:, self._s] = s
        count, *more = self._touching if touching else self._all
        return sum((other.at(rows) for other in more), count.at(rows))

    def blocked_share(self, q_from: np.ndarray, q_to: np.ndarray, s: float, count: int = 10) -> np.ndarray:
        """Share of the straight lines from one posture to several (n, dof) that touches something, (n,)."""
        share = (np.arange(count) + 1.0) / (count + 1.0)
        points = q_from + share[None, :, None] * (q_to[:, None] - q_from)
        hits = self.contacts(points.reshape(-1, q_to.shape[1]), s) > 0
        return hits.reshape(len(q_to), count).mean(axis=1)

    def path_is_free(self, q_path: np.ndarray, s: float, step_rad: float = STEP_RAD) -> bool:
        """True if nothing is touched along a polyline (n, dof), looked at every ``step_rad``."""
        points = [q_path[:1]]
        for a, b in pairwise(q_path):
            count = max(1, int(np.ceil(np.abs(b - a).max() / step_rad)))
            points.append(a + (np.arange(1, count + 1) / count)[:, None] * (b - a))
        return not self.contacts(np.concatenate(points), s).any()


def _of_robot(scene: Scene, threads: int, margin_m: float, *, touching: bool, rims: bool) -> ContactCount:
    """Contacts that the robot has; with ``touching``, fingers against the part have none."""
    kind = scene.geom_kind
    robot, finger = kind >= GeomKind.ROBOT, kind == GeomKind.FINGER
    solid = (scene.solid | scene.rims if rims else scene.solid) & ~robot
    model = _without_contacts(scene)
    model.geom_contype[robot] = np.where(finger[robot], _FINGER_BIT, _ARM_BIT)
    model.geom_conaffinity[robot | solid] = _ARM_BIT | _FINGER_BIT
    if touching:
        model.geom_conaffinity[solid & (kind == GeomKind.PART)] = _ARM_BIT
    _keep_apart(model, robot & ~finger, margin_m)
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
