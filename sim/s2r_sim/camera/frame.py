"""A view as the camera's message."""

from __future__ import annotations

import zlib

import numpy as np

from s2r_protocol.proto import s2r_pb2 as pb
from s2r_sim.camera.camera import View

DEPTH_UNIT_M = 1e-4
_COMPRESSION = 1  # of 9: a frame is asked for now, and loopback is fast


def to_message(
    view: View, camera: str, index: int, stamp_ns: int, K: np.ndarray, X_base_camera: np.ndarray
) -> pb.Frame:
    """The message of one view.

    Args:
        view: What was seen.
        camera, index, stamp_ns: Name, running number, monotonic time of the exposure.
        K: Pinhole matrix, shape (3, 3).
        X_base_camera: Calibrated pose, shape (4, 4).
    """
    height, width = view.depth_m.shape
    counts = np.clip(np.rint(view.depth_m / DEPTH_UNIT_M), 0, 65535).astype("<u2")
    return pb.Frame(
        camera=camera,
        stamp_ns=stamp_ns,
        index=index,
        width=width,
        height=height,
        depth_u16=zlib.compress(counts.tobytes(), _COMPRESSION),
        depth_unit_m=DEPTH_UNIT_M,
        colour_rgb8=zlib.compress(view.colour.tobytes(), _COMPRESSION),
        K=K.ravel().tolist(),
        X_base_camera=X_base_camera.ravel().tolist(),
    )
