"""Places where the hand is free and its fingertip could push the part along its motion, the likeliest first."""

from __future__ import annotations

import heapq
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np

from s2r_host.planning.candidates import FELT_FOR_M, find_candidates
from s2r_host.planning.hand_probe import HandProbe, quats_of
from s2r_host.planning.part_shape import part_box
from s2r_host.planning.scene import Scene
from s2r_host.planning.settings import USUAL_ROOM_M

_PUSH_M = (
    0.003,
    0.006,
    0.009,
    0.012,
    0.016,
    0.024,
    FELT_FOR_M,
)  # how far along the motion the part is felt for
_BACK_M = (0.02, 0.05, 0.09)  # how far the hand must be able to back out
_ROOM_M = (0.003, 0.006)  # sideways steps that tell a roomy place from a tight one
_ALIKE_M, _ALIKE_TRACE = 0.02, 2.9  # places this near to each other, turned this little, share their fate
# Of a place so near to one that moved nothing: as much as turning the hand over.
_MISSED_M, _MISSED_COST = 0.025, 5.0
# Of a place whose touch, seen along the motion, is so near to one that has moved the part.
_PROVEN_M, _PROVEN_GAIN = 0.010, 2.0
_AT_A_TIME = 128  # candidates looked at before it is asked whether they are enough


@dataclass(frozen=True, eq=False)
class Places:
    """Tool poses in the world frame at the present state of the object.

    Attributes:
        p: Tool tips [m], (n, 3).
        R: Tool orientations, (n, 3, 3).
        way: Unit direction of the part's wanted motion there, (n, 3).
        push_m: How far along it the fingertip meets the part, (n,).
        blocked: How many of ten small steps aside or deeper would touch something, (n,).
    """

    p: np.ndarray
    R: np.ndarray
    way: np.ndarray
    push_m: np.ndarray
    blocked: np.ndarray

    def __len__(self) -> int:
        return len(self.p)

    def at(self, index: np.ndarray) -> Places:
        """Some of them, by index (m,) or mask (n,)."""
        return Places(self.p[index], self.R[index], self.way[index], self.push_m[index], self.blocked[index])

    @classmethod
    def all_of(cls, groups: list[Places]) -> Places:
        """The places of several groups in one, maybe none."""
        groups = [_NONE, *groups]
        return cls(
            np.concatenate([group.p for group in groups]),
            np.concatenate([group.R for group in groups]),
            np.concatenate([group.way for group in groups]),
            np.concatenate([group.push_m for group in groups]),
            np.concatenate([group.blocked for group in groups]),
        )


_NONE = Places(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3)), np.zeros(0), np.zeros(0, dtype=int))


def in_world(scene: Scene, data: mujoco.MjData, places: Sequence[Sequence[float]]) -> np.ndarray:
    """Places in the part's frame [m], as settings have them, in the world frame, (n, 3)."""
    given = np.array(places, dtype=float).reshape(-1, 3)
    return data.xpos[scene.part_body] + given @ data.xmat[scene.part_body].reshape(3, 3).T


def tightness(places: Places, room_m: float, missed: np.ndarray) -> np.ndarray:
    """Cost of places that leave little room or are far from the touch, (n,), in units of radians of travel.

    So have those near one of some others, (m, 3) [m], from which nothing was moved.

    Room towards the part counts most: a fingertip that comes down within a few millimetres of an edge lands on it
    when the object stands a little nearer than believed, and jams there.
    """
    near, far = np.maximum(room_m - places.push_m, 0.0), np.maximum(places.push_m - (room_m + 0.004), 0.0)
    again = (np.linalg.norm(places.p[:, None] - missed, axis=2) < _MISSED_M).any(axis=1)
    return 0.2 * places.blocked + 150.0 * near + 5.0 * far + _MISSED_COST * again


def gain_of_proven(p: np.ndarray, way: np.ndarray, proven: np.ndarray) -> np.ndarray:
    """What places are worth for having moved the part before, (n,), in the units of :func:`tightness`.

    What a motion taught about the surface it pushed holds where it touched it; elsewhere along a bar the same turn is
    another distance, and a hinge a little off another turn.

    Args:
        p: Tool tips [m], (n, 3).
        way: Unit directions of the part's motion there, (n, 3).
        proven: Tool tips that have moved it [m], (m, 3).
    """
    apart = p[:, None] - proven
    across = apart - np.einsum("nmi,ni->nm", apart, way)[..., None] * way[:, None]
    return _PROVEN_GAIN * (np.linalg.norm(across, axis=2) < _PROVEN_M).any(axis=1)


class PlaceSearch:
    """Places around the part for its motion, given out in the order of their cost, none like one before.

    What rays have found is sorted by what it costs at least, and the hand is tried only at as much of it as it takes to
    know which places come next.
    """

    def __init__(
        self,
        scene: Scene,
        data: mujoco.MjData,
        probe: HandProbe,
        sign: float,
        points: int,
        *,
        ways: str = "usual",
        room_m: float = USUAL_ROOM_M,
        deep: bool = False,
        missed: Sequence[Sequence[float]] = (),
        proven: Sequence[Sequence[float]] = (),
    ) -> None:
        """Look behind the faces of the part; nothing is tried yet.

        Args:
            scene: The models.
            data: State of the fine model; where the tool is there counts in the cost.
            probe: The hand.
            sign: Of the motion: towards growing (1) or falling s (-1).
            points: So many at most, spread over the faces of the part, are looked at.
            ways: "usual", the hand comes level and from above; "oblique", slantwise as well, as behind an upright bar
                close to its door; "upward", from below, as to what is overhead.
            room_m: Way from a place to the touch that is wished for [m]. For more than the usual, places further
                behind the part are looked at, too.
            deep: None that only grazes the part.
            missed: Places in the part's frame [m], (3,) each, from which nothing was moved: those near them come last.
            proven: The same of such from which the part was moved: those like them come first.
        """
        self._probe, self._room_m = probe, room_m
        self._missed = in_world(scene, data, missed)
        p, R, way = find_candidates(scene, data, sign, points, ways=ways, room_m=room_m, deep=deep)
        least = least_costs(scene, data, p, R) - gain_of_proven(p, way, in_world(scene, data, proven))
        order = np.argsort(least, kind="stable")
        self._p, self._R, self._way, self._least = p[order], R[order], way[order], least[order]
        self._next = 0  # row of the first that the hand has not been tried at
        self._alike = np.zeros(len(order), dtype=bool)  # to one that was given out
        self._tried: list[tuple[float, int]] = []  # heap of cost and row
        self._places_of: dict[int, tuple[Places, int]] = {}

    def take(self, count: int) -> Places:
        """The next ``count`` places, or as many as there are."""
        given: list[Places] = []
        while len(given) < count:
            ahead = self._least[self._next] if self._next < len(self._least) else np.inf
            if self._tried and self._tried[0][0] <= ahead:
                row = heapq.heappop(self._tried)[1]
                places, index = self._places_of.pop(row)
                if not self._alike[row]:
                    given.append(places.at(np.array([index])))
                    self._alike |= self._like(row)
            elif self._next < len(self._least):
                self._try_next()
            else:
                break
        return Places.all_of(given)

    def _like(self, row: int) -> np.ndarray:
        """Which candidates are like the one in a row, bool (n,)."""
        near = np.flatnonzero(np.square(self._p - self._p[row]).sum(axis=1) < _ALIKE_M**2)
        like = np.zeros(len(self._p), dtype=bool)
        like[near[self._R[near].reshape(-1, 9) @ self._R[row].ravel() > _ALIKE_TRACE]] = True
        return like

    def _try_next(self) -> None:
        """Try the hand at the next candidates that are unlike all places given out."""
        rows = self._next + np.flatnonzero(~self._alike[self._next :])[:_AT_A_TIME]
        self._next = int(rows[-1]) + 1 if len(rows) == _AT_A_TIME else len(self._least)
        rows, places = self._tried_at(rows)
        costs = self._least[rows] + tightness(places, self._room_m, self._missed)
        for index, (row, cost) in enumerate(zip(rows.tolist(), costs.tolist(), strict=True)):
            heapq.heappush(self._tried, (cost, row))
            self._places_of[row] = places, index

    def _tried_at(self, rows: np.ndarray) -> tuple[np.ndarray, Places]:
        """Of candidates those where the hand is free, meets the part and can back out: rows (n,) and places."""
        probe = self._probe
        p, R, way = self._p[rows], self._R[rows], self._way[rows]
        quat = quats_of(R)
        push_m = np.full(len(rows), np.inf)
        free = probe.contacts(p, quat) == 0
        push_m[free] = _push_distances(probe, p[free], quat[free], way[free])
        good = np.isfinite(push_m)
        for back in _BACK_M:
            good[good] = probe.contacts((p - back * R[:, :, 2])[good], quat[good]) == 0
        p, R, way, quat, push_m = p[good], R[good], way[good], quat[good], push_m[good]
        return rows[good], Places(p, R, way, push_m, _blocked_steps(probe, p, R, quat, way))


def least_costs(scene: Scene, data: mujoco.MjData, p: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Cost before the hand and any posture is tried, (n,): turning, way, off-centre for slides, short levers."""
    p_now = data.site_xpos[scene.tool_site]
    R_now = data.site_xmat[scene.tool_site]
    turn = np.arccos(np.clip((R.reshape(-1, 9) @ R_now - 1.0) / 2.0, -1.0, 1.0))
    way = np.linalg.norm(p - p_now, axis=1)
    if scene.prismatic:
        low, high = part_box(scene, data)
        leverage = 4.0 * np.linalg.norm(p[:, :2] - (low + high)[:2] / 2.0, axis=1)
    else:
        leverage = -8.0 * scene.lever(data, p)
    return turn + 2.0 * way + leverage


def _push_distances(probe: HandProbe, p: np.ndarray, quat: np.ndarray, way: np.ndarray) -> np.ndarray:
    """How far along the motion the fingertip alone meets the part, (n,); infinite if it never does or more does."""
    push_m = np.full(len(p), np.inf)
    left = np.arange(len(p))
    for push in _PUSH_M:
        moved = p[left] + push * way[left]
        total = probe.contacts(moved, quat[left])
        finger = np.zeros(len(left), dtype=int)
        finger[total > 0] = probe.finger_contacts(moved[total > 0], quat[left[total > 0]])
        push_m[left[(finger > 0) & (finger == total)]] = push
        left = left[total == 0]
    return push_m


def _blocked_steps(
    probe: HandProbe, p: np.ndarray, R: np.ndarray, quat: np.ndarray, way: np.ndarray
) -> np.ndarray:
    """How many small steps aside or deeper would touch something, (n,); longer ones towards the part may."""
    steps = np.stack([R[:, :, 0], -R[:, :, 0], R[:, :, 1], -R[:, :, 1], R[:, :, 2]])
    moved = p + np.multiply.outer(_ROOM_M, steps)  # (length, direction, n, 3)
    hits = probe.contacts(moved.reshape(-1, 3), np.tile(quat, (10, 1))).reshape(2, 5, -1) > 0
    towards_part = np.vecdot(steps, way) > 0.7
    return hits[0].sum(axis=0) + (hits[1] & ~towards_part).sum(axis=0)
