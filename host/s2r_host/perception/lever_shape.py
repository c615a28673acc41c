"""A lever as a solid: a straight bar or rod on a hinge, its outline for a camera, and the depth a camera has of it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.motion import JointMotion, rotation, unit

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

ROOT_M = 0.028  # from the hinge's axis, within which a bar is hidden by its hub
STEP_M = 0.003  # between points of an outline
LEAST_HALF_M = 0.003  # hardly a lever is thinner
NEXT_M = 0.001  # from a point of an outline to the one that tells which way it runs
ROUND_STEPS = 6  # at least, about a rod's end


@dataclass(frozen=True, eq=False)
class LeverShape:
    """A bar, base frame.

    Attributes:
        p_middle: A point of its middle line [m], (3,).
        frame: Its directions in columns: along it away from the hinge, along its motion, across both, (3, 3).
        root_m, end_m: From ``p_middle`` along it to where it leaves its hub and to its end [m].
        half_m: Half its width along its motion and across; of a rod twice its radius [m], (2,).
        rod: It is round and so is its end; otherwise a box.
    """

    p_middle: Array
    frame: Array
    root_m: float
    end_m: float
    half_m: Array
    rod: bool

    @property
    def along(self) -> Array:
        """Unit vector along it, (3,)."""
        return np.asarray(self.frame[:, 0])

    @property
    def thinnest(self) -> bool:
        """It is as thin as a lever may be: what looks like that is a part of one, or none."""
        return bool(self.half_m.min() <= LEAST_HALF_M)

    def carried(self, motion: JointMotion) -> LeverShape:
        """The same, moved."""
        X = motion.transform()
        return replace(self, p_middle=X[:3, :3] @ self.p_middle + X[:3, 3], frame=X[:3, :3] @ self.frame)

    def from_hinge(self, hinge: JointMotion) -> LeverShape:
        """The same, beginning where it leaves the hub about a hinge."""
        away = self.p_middle - hinge.origin
        away = away - (away @ hinge.direction) * hinge.direction
        side = self.along - (self.along @ hinge.direction) * hinge.direction
        slope = max(float(side @ side), 1e-9)
        nearest = -float(away @ side) / slope
        off2 = float(away @ away) - nearest**2 * slope
        return replace(self, root_m=nearest + float(np.sqrt(max(ROOT_M**2 - off2, 0.0) / slope)))

    def changed(
        self, shift_m: Array, slope: Array, longer_m: float, wider_m: Array, roll: float
    ) -> LeverShape:
        """A bar like this one.

        Args:
            shift_m: Of its middle line along the motion and across [m], (2,).
            slope: By which the line leans those two ways, (2,).
            longer_m: At its end [m].
            wider_m: Half widths' growth [m], (2,); a rod has the first.
            roll: About itself [rad].
        """
        along = unit(self.frame @ np.r_[1.0, slope])
        way = unit(self.frame[:, 1] - (self.frame[:, 1] @ along) * along)
        way = rotation(along, roll) @ way
        half = np.maximum(self.half_m + (wider_m[0] if self.rod else wider_m), LEAST_HALF_M)
        return replace(
            self,
            p_middle=self.p_middle + self.frame[:, 1:] @ shift_m,
            frame=np.column_stack([along, way, np.cross(along, way)]),
            end_m=self.end_m + longer_m,
            half_m=half,
        )

    def outline(self, p_camera: Array) -> tuple[OutlinePoints, OutlinePoints]:
        """What a camera at (3,) may see as an edge of it, and next to each of these points another of the same edge."""
        camera = (p_camera - self.p_middle) @ self.frame
        return self._rod_outline(camera) if self.rod else self._box_outline(camera)

    def _box_outline(self, camera: Array) -> tuple[OutlinePoints, OutlinePoints]:
        """The edges next to a face that the camera, (3,) in the bar's frame, sees."""
        sides = [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)]
        seen = {side: bool(camera[1:] @ side > np.abs(self.half_m @ side)) for side in sides}
        end_seen = bool(camera[0] > self.end_m)
        lines: list[tuple[Array, Array, bool]] = []
        along = np.arange(self.root_m, self.end_m - 1e-4, STEP_M)
        for way in (1.0, -1.0):
            for across in (1.0, -1.0):
                if seen[way, 0.0] or seen[0.0, across]:
                    corner = np.broadcast_to(np.array([way, across]) * self.half_m, (len(along), 2))
                    lines.append((np.column_stack([along, corner]), np.array([NEXT_M, 0.0, 0.0]), False))
        for side in sides:
            if end_seen or seen[side]:
                k = 1 if side[0] == 0.0 else 2  # the direction that the edge runs
                half = float(self.half_m[k - 1])
                steps = np.arange(-half + 0.5 * STEP_M, half, STEP_M)
                points = np.tile(np.r_[0.0, np.array(side) * self.half_m], (len(steps), 1))
                points[:, k] = steps
                lines.append((points, NEXT_M * np.eye(3)[k], True))
        return self._points(lines)

    def _rod_outline(self, camera: Array) -> tuple[OutlinePoints, OutlinePoints]:
        """Where lines of sight from the camera, (3,) in the rod's frame, touch it: two lines and half a ring."""
        r = float(self.half_m[0])
        straight_m = self.end_m - r
        away = max(float(np.linalg.norm(camera[1:])), 1.01 * r)
        towards = np.r_[0.0, camera[1:] / away]
        aside = np.array([0.0, -towards[2], towards[1]])
        cosine = r / away
        along = np.arange(self.root_m, straight_m, STEP_M)
        lines: list[tuple[Array, Array, bool]] = []
        for sign in (1.0, -1.0):
            touched = r * (cosine * towards + sign * np.sqrt(1.0 - cosine**2) * aside)
            lines.append((touched + np.outer(along, np.eye(3)[0]), np.array([NEXT_M, 0.0, 0.0]), False))
        centre = np.array([-r, 0.0, 0.0])  # of the end's ball, from the end
        sight = camera - np.array([straight_m, 0.0, 0.0])
        far = max(float(np.linalg.norm(sight)), 1.01 * r)
        sight = sight / far
        across = np.cross(sight, np.eye(3)[0])
        if np.linalg.norm(across) > 0.05:
            across = unit(across)
            out = np.cross(across, sight)
            out = out if out[0] > 0.0 else -out
            angle = np.linspace(0.1, np.pi - 0.1, max(ROUND_STEPS, int(np.pi * r / STEP_M)))
            ring = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * out
            onward = -np.sin(angle)[:, None] * across + np.cos(angle)[:, None] * out
            points = centre + sight * r * r / far + r * np.sqrt(1.0 - (r / far) ** 2) * ring
            lines.append((points, NEXT_M * onward, True))
        return self._points(lines)

    def _points(self, lines: list[tuple[Array, Array, bool]]) -> tuple[OutlinePoints, OutlinePoints]:
        lines = [(np.empty((0, 3)), np.zeros(3), False), *lines]  # a camera within a bar sees none
        p = np.concatenate([line for line, _, _ in lines])
        onward = np.concatenate([np.broadcast_to(step, line.shape) for line, step, _ in lines])
        at_end = np.concatenate([np.full(len(line), end) for line, _, end in lines])
        scale = np.r_[1.0, self.half_m]
        return OutlinePoints(p / scale, at_end), OutlinePoints((p + onward) / scale, at_end)

    def behind_m(self, p_camera: Array, p: Array) -> tuple[Array, Array, Mask]:
        """How far depth readings lie behind the bar that they are taken for.

        Args:
            p_camera: Where they were taken from [m], (3,).
            p: The readings [m], (n, 3).

        Returns:
            Distances along the lines of sight [m], (n,); where along the bar these meet it [m], (n,); which do, (n,).
        """
        sight = p - p_camera
        distance = np.linalg.norm(sight, axis=1)
        way = (sight / distance[:, None]) @ self.frame
        eye = (p_camera - self.p_middle) @ self.frame
        with np.errstate(divide="ignore", invalid="ignore"):
            if self.rod:
                near, hit = self._on_rod(eye, way)
            else:
                low, high = np.r_[self.root_m, -self.half_m], np.r_[self.end_m, self.half_m]
                one, other = (low - eye) / way, (high - eye) / way
                near, far = np.minimum(one, other).max(axis=1), np.maximum(one, other).min(axis=1)
                hit = near < far
        along = eye[0] + np.where(hit, near, 0.0) * way[:, 0]
        return distance - np.where(hit, near, 0.0), along, hit

    def _on_rod(self, eye: Array, way: Array) -> tuple[Array, Mask]:
        """Distances at which lines of sight (n, 3) from a point (3,) meet the rod's side, and which do, (n,) each."""
        a, b = (way[:, 1:] ** 2).sum(axis=1), way[:, 1:] @ eye[1:]
        inside = b * b - a * (eye[1:] @ eye[1:] - self.half_m[0] ** 2)
        near = (-b - np.sqrt(np.maximum(inside, 0.0))) / a
        along = eye[0] + near * way[:, 0]
        return near, (inside > 0.0) & (along > self.root_m) & (along < self.end_m)


@dataclass(frozen=True, eq=False)
class OutlinePoints:
    """Points of a bar's outline that go along with its size.

    Attributes:
        at: Along the bar [m], from its end for those of its end; the two ways across in half widths, (n, 3).
        at_end: They are the end's, (n,).
    """

    at: Array
    at_end: Mask

    def of(self, chosen: Mask) -> OutlinePoints:
        """Some of them."""
        return OutlinePoints(self.at[chosen], self.at_end[chosen])

    def on(self, shape: LeverShape) -> Array:
        """Where they are on a bar [m], (n, 3)."""
        local = self.at * np.r_[1.0, shape.half_m]
        local[:, 0] += np.where(self.at_end, shape.end_m, 0.0)
        return shape.p_middle + local @ shape.frame.T
