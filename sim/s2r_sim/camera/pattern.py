"""The projector's dot pattern: random dots in the tangent plane of its field of view."""

from __future__ import annotations

import cv2
import numpy as np

TEXTURE_PX = 2048
DOTS = 150_000  # some 35 000 in the camera's field of view, a dot every 3 to 4 pixels
DOT_SIGMA_PX = 1.1


def dot_texture(rng: np.random.Generator) -> np.ndarray:
    """A dot pattern, values 0..1, shape (TEXTURE_PX, TEXTURE_PX), float32."""
    texture = np.zeros((TEXTURE_PX, TEXTURE_PX), np.float32)
    rows, columns = rng.integers(0, TEXTURE_PX, (2, DOTS))
    np.add.at(texture, (rows, columns), rng.uniform(0.5, 1.0, DOTS).astype(np.float32))
    texture = cv2.GaussianBlur(texture, (0, 0), DOT_SIGMA_PX)
    return np.minimum(texture / (0.8 * texture.max()), 1.0)


def illuminate(
    texture: np.ndarray, tan_x: np.ndarray, tan_y: np.ndarray, half_angle_rad: float
) -> np.ndarray:
    """Brightness of the pattern in directions seen from the projector, 0 outside its field.

    Args:
        texture: From :func:`dot_texture`.
        tan_x, tan_y: x/z and y/z in the projector's frame, shape (height, width), float32.
        half_angle_rad: Half of its square field of view.
    """
    scale = np.float32(TEXTURE_PX / (2 * np.tan(half_angle_rad)))
    middle = np.float32(TEXTURE_PX / 2)
    return cv2.remap(
        texture, tan_x * scale + middle, tan_y * scale + middle, cv2.INTER_LINEAR, borderValue=0.0
    )
