"""From two infrared images to depth: semi-global matching and the filters a depth camera applies."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

DISPARITIES = 128


@dataclass(frozen=True)
class Matching:
    """Settings of the matcher.

    Attributes:
        block_px: Side of the window of the coarse, whole-pixel match.
        smooth_small, smooth_large: Penalties of disparity steps of one and of more pixels, per window pixel.
        uniqueness_percent: The best match must beat the second by this much.
        left_right_px: Largest disagreement of both directions.
        speckle_px, speckle_range_px: Smaller islands of similar disparity are removed.
        refine_px: Side of the window of the sub-pixel match.
        refine_rounds: Newton steps of the sub-pixel match.
        correlation_min: Windows that correlate less than this are no match.
    """

    block_px: int = 5
    smooth_small: int = 4
    smooth_large: int = 24
    uniqueness_percent: int = 8
    left_right_px: int = 1
    speckle_px: int = 120
    speckle_range_px: int = 2
    refine_px: int = 7
    refine_rounds: int = 3
    correlation_min: float = 0.75


def disparity(left: np.ndarray, right: np.ndarray, settings: Matching) -> np.ndarray:
    """Disparity of a rectified pair [px], 0 where there is none, shape (height, width), float32."""
    coarse = _coarse(left, right, settings)
    fine, correlation = _refine(left, right, coarse, settings)
    trusted = (coarse > 0) & (correlation >= settings.correlation_min) & (np.abs(fine - coarse) <= 1.0)
    return np.where(trusted, fine, 0.0).astype(np.float32)


def _coarse(left: np.ndarray, right: np.ndarray, settings: Matching) -> np.ndarray:
    """Semi-global matching. Its sub-pixel digits lock onto whole pixels, so only the neighbourhood is believed."""
    b = settings.block_px
    matcher = cv2.StereoSGBM.create(
        minDisparity=0,
        numDisparities=DISPARITIES,
        blockSize=b,
        P1=settings.smooth_small * b * b,
        P2=settings.smooth_large * b * b,
        disp12MaxDiff=settings.left_right_px,
        preFilterCap=31,
        uniquenessRatio=settings.uniqueness_percent,
        speckleWindowSize=settings.speckle_px,
        speckleRange=settings.speckle_range_px,
        mode=cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    )
    # The matcher leaves out the first columns: give it room on the left.
    pad = DISPARITIES
    padded = [
        cv2.copyMakeBorder(image, 0, 0, pad, 0, cv2.BORDER_CONSTANT, value=0) for image in (left, right)
    ]
    return np.maximum(matcher.compute(*padded)[:, pad:].astype(np.float32) / 16.0, 0.0)


def _refine(
    left: np.ndarray, right: np.ndarray, start: np.ndarray, settings: Matching
) -> tuple[np.ndarray, np.ndarray]:
    """Move each window of the right image by fractions of a pixel until it fits (Lucas-Kanade along the row).

    Returns:
        Disparity [px] and normalised correlation of the windows, both of shape (height, width).
    """
    side = (settings.refine_px, settings.refine_px)
    a = cv2.GaussianBlur(left.astype(np.float32), (0, 0), 0.6)
    b = cv2.GaussianBlur(right.astype(np.float32), (0, 0), 0.6)
    slope = cv2.Sobel(b, cv2.CV_32F, 1, 0, ksize=1, scale=0.5)
    columns, rows = np.meshgrid(
        np.arange(a.shape[1], dtype=np.float32), np.arange(a.shape[0], dtype=np.float32)
    )
    mean_a = cv2.boxFilter(a, -1, side)
    var_a = cv2.boxFilter(a * a, -1, side) - mean_a * mean_a
    d = start.astype(np.float32)
    moved = cv2.remap(b, columns - d, rows, cv2.INTER_CUBIC)
    for _ in range(settings.refine_rounds):
        gradient = cv2.remap(slope, columns - d, rows, cv2.INTER_LINEAR)
        residual = moved - a - cv2.boxFilter(moved - a, -1, side)
        step = cv2.boxFilter(gradient * residual, -1, side) / (
            cv2.boxFilter(gradient * gradient, -1, side) + 1e-3
        )
        d = d + np.clip(step, -0.5, 0.5)
        moved = cv2.remap(b, columns - d, rows, cv2.INTER_CUBIC)
    mean_b = cv2.boxFilter(moved, -1, side)
    var_b = cv2.boxFilter(moved * moved, -1, side) - mean_b * mean_b
    covariance = cv2.boxFilter(a * moved, -1, side) - mean_a * mean_b
    return d, covariance / np.sqrt(np.maximum(var_a * var_b, 1e-6))


def depth(disparity_px: np.ndarray, f_px: float, baseline_m: float, reach_m: float) -> np.ndarray:
    """Depth [m] from disparity [px], 0 where there is none or beyond ``reach_m``."""
    with np.errstate(divide="ignore"):
        z = np.where(disparity_px > 0, f_px * baseline_m / disparity_px, 0.0)
    return np.where((z > 0) & (z <= reach_m), z, 0.0).astype(np.float32)
