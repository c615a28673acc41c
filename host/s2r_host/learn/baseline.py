"""The trained baseline at work: one joint from two views, as the mean of what it tells of the part's points.

It is measured beside the others (`tests/bench/bench_perception.py`) and used for nothing else, so it needs PyTorch and
comes with no weights.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray
from safetensors.torch import load_file

from s2r_host.learn.baseline_draws import inputs_of, plain_cloud
from s2r_host.learn.baseline_network import (
    PART,
    SIZES,
    SLIDE_DIRECTION,
    SLIDE_DISTANCE,
    SLIDES,
    TURN_ANGLE,
    TURN_DIRECTION,
    WAY_DIRECTION,
    WAY_LENGTH,
    BaselineNetwork,
)
from s2r_host.learn.checkpoint import STATE, WEIGHTS
from s2r_host.perception.errors import AbstainError, InputError
from s2r_host.perception.evidence import Scene
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.pair_cloud import PairCloud, facing, pool

Array = NDArray[np.floating]


class BaselineRuntime:
    """A trained baseline, one pass over one choice of points. Make one and keep it."""

    def __init__(self, folder: Path) -> None:
        """Load the weights that ``s2r train baseline`` left in a folder.

        Raises:
            InputError: A file is missing, or the folder holds another network.
        """
        for name in (WEIGHTS, STATE):
            if not (folder / name).exists():
                raise InputError(
                    f"no baseline in {folder} ({name} is missing); train one: s2r train baseline --out {folder}"
                )
        size = json.loads((folder / STATE).read_text())["settings"].get("size")
        if size not in SIZES:
            raise InputError(
                f"{folder} holds no baseline: its size is {size}, known are {', '.join(SIZES)}; "
                "give a folder of s2r train baseline"
            )
        self.network = BaselineNetwork(SIZES[size]).eval()
        self.network.load_state_dict(load_file(folder / WEIGHTS))

    def motion(self, scene: Scene, rng: np.random.Generator) -> JointMotion:
        """The joint between two views.

        Raises:
            NothingMovedError: Hardly anything changed between the views.
            AbstainError: No point of the first view is believed to belong to the part that moved.
        """
        cloud = plain_cloud(pool(scene, rng), self.network.size.points, rng)
        inputs, turned, half_m = inputs_of(cloud, self.network.size)
        with torch.no_grad():
            planes, _ = self.network(*inputs)
            told = self.network.joint(planes, inputs[0][:, 0])[0].numpy()
        found = mean_joint(turned, told, half_m)
        if found is None:
            raise AbstainError("no point of the first view is believed to belong to a part that moved")
        return in_views(found, cloud)


def mean_joint(cloud: PairCloud, told: Array, half_m: float) -> JointMotion | None:
    """Ditto's joint: the mean of what is told (P, JOINT) of the first view's points; None without a part.

    Args:
        cloud: In the network's frame [m].
        told: Columns of `baseline_network`.
        half_m: Half the side of the cube [m].
    """
    mine = told[:, PART] > 0
    if not mine.any():
        return None
    p, told = cloud.points[0][mine], told[mine].astype(float)
    if (1 / (1 + np.exp(-told[:, SLIDES]))).mean() > 0.5:
        direction = _unit(told[:, SLIDE_DIRECTION]).mean(axis=0)
        delta = half_m * told[:, SLIDE_DISTANCE].mean()
        return JointMotion("prismatic", p.mean(axis=0), _unit(direction), float(delta)).positive()
    direction = _unit(_unit(told[:, TURN_DIRECTION]).mean(axis=0))
    feet = p + half_m * told[:, WAY_LENGTH, None] * _unit(told[:, WAY_DIRECTION])
    # Feet of points that agree lie along the line; their mean is on it.
    return JointMotion("revolute", feet.mean(axis=0), direction, float(told[:, TURN_ANGLE].mean())).positive()


def in_views(motion: JointMotion, cloud: PairCloud) -> JointMotion:
    """A motion in the network's frame, in that of the views of ``cloud``."""
    R = facing(cloud.heading)
    return JointMotion(
        motion.joint_type,
        cloud.centre + (motion.origin - cloud.centre) @ R,
        motion.direction @ R,
        motion.delta,
    )


def _unit(v: Array) -> Array:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)
