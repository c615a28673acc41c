"""Geometry of the stand-in's depth camera: a D415 at 848x480."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np


@dataclass(frozen=True, eq=False)
class StereoRig:
    """Two infrared imagers and a dot projector, all looking along +z (OpenCV axes), in the left imager's frame.

    Attributes:
        width, height: Image [px].
        f_px: Focal length of both imagers; 666 px give the D415's 65 x 40 degrees.
        baseline_m: Right imager at +x.
        projector_m: Position of the projector.
        projector_half_angle_rad: Edge of its square field.
    """

    width: int = 848
    height: int = 480
    f_px: float = 666.0
    baseline_m: float = 0.055
    projector_m: tuple[float, float, float] = (0.030, 0.0, 0.0)
    projector_half_angle_rad: float = np.deg2rad(45.0)

    @cached_property
    def K(self) -> np.ndarray:
        """Pinhole matrix of the left imager, to which depth and colour are registered, shape (3, 3)."""
        c_x, c_y = (self.width - 1) / 2, (self.height - 1) / 2
        return np.array([[self.f_px, 0.0, c_x], [0.0, self.f_px, c_y], [0.0, 0.0, 1.0]])

    @cached_property
    def rays(self) -> np.ndarray:
        """Viewing rays with z = 1 in camera axes, shape (height * width, 3): a distance along them is a depth."""
        return self._rays(0)

    @property
    def projector_margin_px(self) -> int:
        """Columns the projector sees beyond the imagers' left and right edge (shadows of near objects)."""
        return 160

    @cached_property
    def projector_rays(self) -> np.ndarray:
        """Like :attr:`rays`, with :attr:`projector_margin_px` more columns on both sides."""
        return self._rays(self.projector_margin_px)

    def _rays(self, margin_px: int) -> np.ndarray:
        u, v = np.meshgrid(np.arange(-margin_px, self.width + margin_px), np.arange(self.height))
        x, y = (u - self.K[0, 2]) / self.f_px, (v - self.K[1, 2]) / self.f_px
        return np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
