"""Postures of the whole arm among the scene's geoms: which touch something, many at a time, without physics."""

from __future__ import annotations

import copy
from itertools import pairwise

import mujoco
import mujoco.batch
import numpy as np

from s2r_host.planning.scene import GeomKind, Scene

_ARM_BIT, _FINGER_BIT = 1, 2
_CHUNK = 256
STEP_RAD = 0.06  # between postures that are looked at along a line
FINE_STEP_RAD = 0.02  # the same where a way is to be gone: no bar is stepped over


class FreeSpace:
    """Counts the robot's contacts at postures of the arm and states of the object."""

    def __init__(
        self, scene: Scene, threads: int, margin_m: float = 0.0, others: np.ndarray | None = None
    ) -> None:
        """Args: scene; threads; ``margin_m``, distance that counts as a contact already, fingertip excepted.

        ``others`` are the positions of everything besides the arm, (nq - dof,); None: as the file has them.
        """
        self._dof, self._s = scene.dof, scene.s_qpos
        self._all = self._batch(scene, threads, margin_m, touching=False)
        self._touching = self._batch(scene, threads, margin_m, touching=True)
        self._qpos0 = scene.fine.qpos0.copy()
        if others is not None:
            self._qpos0[scene.dof :] = others

    @staticmethod
    def _batch(scene: Scene, threads: int, margin_m: float, *, touching: bool) -> mujoco.batch.Batch:
        """A batch in which only the robot has contacts; with ``touching``, fingers against the part have none."""
        model = copy.copy(scene.fine)
        kind = scene.geom_kind
        robot, finger = kind >= GeomKind.ROBOT, kind == GeomKind.FINGER
        solid = scene.solid & ~robot
        model.geom_contype[:] = 0
        model.geom_conaffinity[:] = 0
        model.geom_contype[robot] = np.where(finger[robot], _FINGER_BIT, _ARM_BIT)
        model.geom_conaffinity[robot | solid] = _ARM_BIT | _FINGER_BIT
        if touching:
            model.geom_conaffinity[solid & (kind == GeomKind.PART)] = _ARM_BIT
        if margin_m > 0.0:
            model.geom_margin[robot & ~finger] = margin_m
            model.geom_gap[robot & ~finger] = margin_m
        return mujoco.batch.Batch(model, nsim=_CHUNK, nthread=threads)

    def contacts(self, q: np.ndarray, s: float | np.ndarray, *, touching: bool = False) -> np.ndarray:
        """Number of contacts, (n,), at postures q (n, dof) with the object's joint at s; see ``touching`` above."""
        batch = self._touching if touching else self._all
        qpos, ncon = batch.bind("qpos"), batch.bind("ncon")
        counts = np.zeros(len(q), dtype=int)
        s = np.broadcast_to(s, len(q))
        for start in range(0, len(q), _CHUNK):
            part = slice(start, start + _CHUNK)
            ids = np.arange(len(q[part]))
            rows = np.tile(self._qpos0, (len(ids), 1))
            rows[:, : self._dof] = q[part]
            rows[:, self._s] = s[part]
            qpos[ids] = rows
            batch.forward(ids=ids, stage=int(mujoco.mjtStage.mjSTAGE_POS))
            counts[part] = np.asarray(ncon)[ids].reshape(-1)
        return counts

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
