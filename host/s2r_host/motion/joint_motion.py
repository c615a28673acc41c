"""Collision-free joint motions: the straight line when it is free, else RRT-Connect, shortened and rounded.

RRT-Connect after Kuffner and LaValle, "RRT-Connect: an efficient approach to single-query path planning",
ICRA 2000.
"""

from __future__ import annotations

from itertools import pairwise
from typing import Protocol

import numpy as np

from s2r_host.errors import NoMotionError
from s2r_host.motion.collision import CollisionChecker
from s2r_protocol.arms import ArmDescription

STEP_RAD = 0.25
SHORTCUTS = 120
SPACING_RAD = 0.05


class Range(Protocol):
    """An arm's range, as far as a path needs to know it."""

    @property
    def arm(self) -> ArmDescription:
        """Its description."""
        ...

    @property
    def q_min(self) -> np.ndarray:
        """Lower position limits [rad], (dof,)."""
        ...

    @property
    def q_max(self) -> np.ndarray:
        """Upper position limits [rad], (dof,)."""
        ...

    def inside_limits(self, q: np.ndarray) -> bool:
        """Whether a posture is within them."""
        ...


class FreeChecker(Protocol):
    """Whoever else knows what is free, a simulator's model for example."""

    @property
    def arm(self) -> Range:
        """The arm's range."""
        ...

    def touching(self, q: np.ndarray) -> str | None:
        """What touches what at a posture, or None."""
        ...

    def line_is_free(self, q_from: np.ndarray, q_to: np.ndarray) -> bool:
        """Whether the straight joint-space line is free."""
        ...

    def path_is_free(self, q_path: np.ndarray) -> bool:
        """Whether a polyline (n, dof) is free."""
        ...


Checker = CollisionChecker | FreeChecker


def plan_joint_motion(
    checker: Checker,
    q_start: np.ndarray,
    q_goal: np.ndarray,
    rng: np.random.Generator,
    max_nodes: int = 4000,
    what: str = "motion",
) -> np.ndarray:
    """A free joint path of shape (n, dof), evenly spaced and with rounded corners.

    Raises:
        NoMotionError: Start or goal is not free, or no way was found; the text says which.
    """
    arm = checker.arm
    for name, q in (("start", q_start), ("goal", q_goal)):
        if (pair := checker.touching(q)) is not None:
            raise NoMotionError(f"{what}: the {name} posture is not free: {pair}")
        if not arm.inside_limits(q):
            worst = int(np.argmax(np.maximum(arm.q_min - q, q - arm.q_max)))
            raise NoMotionError(
                f"{what}: {name} posture, joint '{arm.arm.joint_names[worst]}' = {q[worst]:.3f} rad is outside "
                f"[{arm.q_min[worst]:.3f}, {arm.q_max[worst]:.3f}] rad"
            )
    if checker.line_is_free(q_start, q_goal):
        return densify(np.array([q_start, q_goal]))
    corners = _connect(checker, q_start, q_goal, rng, max_nodes)
    if corners is None:
        raise NoMotionError(
            f"{what}: no collision-free way found with {max_nodes} nodes; move the object or the start"
        )
    return _rounded(checker, _shortened(checker, corners, rng))


def densify(q_path: np.ndarray, spacing_rad: float = SPACING_RAD) -> np.ndarray:
    """The polyline sampled so that no joint moves more than ``spacing_rad`` between points."""
    parts = [q_path[:1]]
    for a, b in pairwise(q_path):
        count = max(1, int(np.ceil(np.abs(b - a).max() / spacing_rad)))
        parts.append(a + (b - a) * np.arange(1, count)[:, None] / count)
        parts.append(b[None])
    return np.concatenate(parts)


class _Tree:
    def __init__(self, q_root: np.ndarray) -> None:
        self.nodes = [q_root]
        self.parents = [-1]

    def nearest(self, q: np.ndarray) -> int:
        return int(np.argmin(np.linalg.norm(np.array(self.nodes) - q, axis=1)))

    def add(self, q: np.ndarray, parent: int) -> int:
        self.nodes.append(q)
        self.parents.append(parent)
        return len(self.nodes) - 1

    def way_to_root(self, index: int) -> list[np.ndarray]:
        way = []
        while index >= 0:
            way.append(self.nodes[index])
            index = self.parents[index]
        return way


def _connect(
    checker: Checker,
    q_start: np.ndarray,
    q_goal: np.ndarray,
    rng: np.random.Generator,
    max_nodes: int,
) -> np.ndarray | None:
    trees = [_Tree(q_start), _Tree(q_goal)]
    arm = checker.arm
    tries = 0
    while len(trees[0].nodes) + len(trees[1].nodes) < max_nodes and tries < 4 * max_nodes:
        tries += 1
        grown, other = trees[tries % 2], trees[1 - tries % 2]
        # Half the samples near the segment of interest: the whole range of seven joints is mostly elsewhere.
        if rng.random() < 0.5:
            sample = rng.uniform(arm.q_min, arm.q_max)
        else:
            sample = q_start + rng.random() * (q_goal - q_start) + rng.normal(0.0, 0.6, len(q_start))
            sample = np.clip(sample, arm.q_min, arm.q_max)
        new = _extend(checker, grown, sample)
        if new is None:
            continue
        reached = _reach(checker, other, grown.nodes[new])
        if reached is not None:
            from_start = trees[0].way_to_root(new if grown is trees[0] else reached)[::-1]
            to_goal = trees[1].way_to_root(reached if grown is trees[0] else new)
            return np.array(from_start + to_goal[1:])
    return None


def _extend(checker: Checker, tree: _Tree, q: np.ndarray) -> int | None:
    near = tree.nearest(q)
    step = q - tree.nodes[near]
    length = float(np.linalg.norm(step))
    if length < 1e-9:
        return None
    q_new = tree.nodes[near] + step * min(1.0, STEP_RAD / length)
    return tree.add(q_new, near) if checker.line_is_free(tree.nodes[near], q_new) else None


def _reach(checker: Checker, tree: _Tree, q: np.ndarray) -> int | None:
    while True:
        new = _extend(checker, tree, q)
        if new is None:
            return None
        if np.allclose(tree.nodes[new], q):
            return new


def _shortened(checker: Checker, corners: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    path = [np.asarray(q) for q in corners]
    for _ in range(SHORTCUTS):
        if len(path) < 3:
            break
        i, j = sorted(rng.choice(len(path), 2, replace=False))
        if j - i > 1 and checker.line_is_free(path[i], path[j]):
            path[i + 1 : j] = []
    return np.array(path)


def _rounded(checker: Checker, corners: np.ndarray) -> np.ndarray:
    """Corners rounded by a moving average, as widely as stays free; sharp corners cost the time law dearly."""
    dense = densify(corners)
    for half_width in (6, 3, 1):
        kernel = np.ones(2 * half_width + 1) / (2 * half_width + 1)
        pad = np.concatenate(
            [np.repeat(dense[:1], half_width, 0), dense, np.repeat(dense[-1:], half_width, 0)]
        )
        pad = np.concatenate([np.repeat(pad[:1], half_width, 0), pad, np.repeat(pad[-1:], half_width, 0)])
        smooth = np.column_stack(
            [np.convolve(np.convolve(column, kernel, "valid"), kernel, "valid") for column in pad.T]
        )
        smooth = np.concatenate([dense[:1], smooth[1:-1], dense[-1:]])
        if checker.path_is_free(smooth):
            return _distinct(smooth)
    return dense


def _distinct(q_path: np.ndarray) -> np.ndarray:
    """Leave out points closer than a third of the spacing to the last kept one; keep both ends."""
    kept = [q_path[0]]
    for q in q_path[1:-1]:
        if np.abs(q - kept[-1]).max() > SPACING_RAD / 3 and np.abs(q - q_path[-1]).max() > SPACING_RAD / 3:
            kept.append(q)
    return np.array([*kept, q_path[-1]])
