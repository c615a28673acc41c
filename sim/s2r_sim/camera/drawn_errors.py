"""Depth with the errors of a stereo camera drawn instead of matched: a fifth of the cost, for training data.

What `s2r_sim.camera.camera` gets by matching is imitated in disparity: a smooth fixed bias and noise of the size of a
matching window, near surfaces fattened sideways by up to half a window, no return where the right imager does not see
and where surfaces are seen at grazing angles. What is measured is never measured on these.
"""

from __future__ import annotations

import cv2
import numpy as np

from s2r_sim.camera.intrinsics import StereoRig

WINDOW_PX, NOISE_PX = 5, 0.11  # 1.6 mm at 0.75 m, as the matched depth has
FULL_F_PX = 666.0  # focal length at which the numbers here hold
FATTEST_PX = 3
GRAZING_COS = 0.16
FILLED = 0.6  # share of the shadows that the matcher fills from beside


def depth_with_drawn_errors(
    exact_m: np.ndarray,
    cosine: np.ndarray,
    rig: StereoRig,
    bias_px: np.ndarray,
    rng: np.random.Generator,
) -> np.ndarray:
    """What a stereo camera might return.

    Args:
        exact_m: True depth [m], 0 where nothing is in reach, shape (height, width).
        cosine: Of the angle between surface normal and ray, same shape.
        rig: The camera's geometry.
        bias_px: Smooth error of the disparity that stays from frame to frame [px at `FULL_F_PX`], same shape.
        rng: Of the errors.

    Returns:
        Depth [m], 0 where there is no return, float32.
    """
    scale = rig.f_px / FULL_F_PX
    seen = exact_m > 0
    d = np.where(seen, rig.f_px * rig.baseline_m / np.maximum(exact_m, 1e-3), 0.0).astype(np.float32)
    lost = _shadow(d) & (_patches(rng, d.shape) > FILLED)
    lost |= (cosine < GRAZING_COS) & (_patches(rng, d.shape) > 0.3)
    left, right = (round(scale * int(rng.integers(0, FATTEST_PX + 1))) for _ in range(2))
    # A larger disparity is nearer: dilation lets near surfaces grow, further to one side than to the other.
    kernel = np.ones((1 + 2 * round(scale * int(rng.integers(0, 2))), 1 + left + right), np.uint8)
    d = cv2.dilate(d, kernel, anchor=(left, kernel.shape[0] // 2))
    lost &= d < rig.f_px * rig.baseline_m / 0.05
    noise = cv2.GaussianBlur(rng.standard_normal(d.shape).astype(np.float32), (0, 0), WINDOW_PX * scale / 2)
    noise *= np.float32(NOISE_PX * scale / max(float(noise.std()), 1e-9))
    noisy = d + noise + np.float32(scale) * bias_px.astype(np.float32)
    good = (d > 0) & ~lost
    return np.where(good, rig.f_px * rig.baseline_m / np.maximum(noisy, 1.0), 0.0).astype(np.float32)


def _shadow(d: np.ndarray) -> np.ndarray:
    """Pixels whose point the right imager does not see: something nearer on their right covers it there."""
    place = np.arange(d.shape[1], dtype=np.float32) - d
    ahead = np.minimum.accumulate(place[:, ::-1], axis=1)[:, ::-1]
    covered = np.zeros(d.shape, bool)
    covered[:, :-1] = ahead[:, 1:] <= place[:, :-1] - 0.5
    return covered


def _patches(rng: np.random.Generator, shape: tuple[int, int]) -> np.ndarray:
    """Numbers between 0 and 1 that are alike over some ten pixels, of the given shape."""
    coarse = rng.uniform(size=(shape[0] // 8 + 1, shape[1] // 8 + 1)).astype(np.float32)
    return cv2.resize(coarse, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
