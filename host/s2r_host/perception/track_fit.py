"""Where a part lies in a depth frame: what the frame says about its points, and one robust step towards the surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from s2r_host.perception.refine import CORRELATED_POINTS

Array = NDArray[np.floating]
Mask = NDArray[np.bool_]

# A plate whose other face the camera sees: one more unknown, known beforehand to be about this.
PLATE_M, PLATE_SPREAD_M, PLATE_RANGE_M = 0.008, 0.005, (0.001, 0.03)
LEAST_POINTS = 20


@dataclass(frozen=True, eq=False)
class Sighting:
    """The part's points in a frame, at a joint value; arrays (n,).

    Attributes:
        e: Distance of the measured surface along the outward normal [m].
        slope: Its change per joint value [m/rad or 1].
        sigma: Depth noise there [m].
        front, back: In the image, with the normal to the camera or away from it.
        known: In the image, with a return that is not of what stands still.
        through: The camera looked through the point, or sees what stands still where the part would hide it.
    """

    e: Array
    slope: Array
    sigma: Array
    front: Mask
    back: Mask
    known: Mask
    through: Mask


@dataclass(frozen=True)
class Fit:
    """One step of the fit.

    Attributes:
        step: What to add to the joint value [rad or m].
        plate_m: Thickness of the part [m].
        spread_m: Robust spread of the distances [m].
        share: Of the points in the image whose surface should be seen, the share on a matching one.
        through: Of the points that match or are looked through, the share of these.
        variance: Of the joint value [rad² or m²].
        lever: Root mean square of the slopes [m/rad or 1].
    """

    step: float
    plate_m: float
    spread_m: float
    share: float
    through: float
    variance: float
    lever: float


def fit_step(seen: Sighting, plate_m: float, gate_m: float, spread_m: float, is_plate: bool) -> Fit | None:
    """One robust step towards the measured surface; None where too little of it is near."""
    shown = seen.front | (seen.back & is_plate)
    r = seen.e + np.where(seen.back, plate_m, 0.0)
    use = shown & seen.known & (np.abs(r) < gate_m)
    if use.sum() < LEAST_POINTS:
        return None
    r, slope, back = r[use], seen.slope[use], seen.back[use].astype(float)
    weight = 1.0 / (1.0 + (r / (2 * seen.sigma[use])) ** 2)
    # The surface lies at e; a step moves the part by slope * step, a thicker plate its other face by the thickness.
    believed = CORRELATED_POINTS * (max(spread_m, 0.0005) / PLATE_SPREAD_M) ** 2
    H = np.array(
        [
            [(weight * slope**2).sum(), -(weight * slope * back).sum()],
            [-(weight * slope * back).sum(), (weight * back).sum() + believed],
        ]
    )
    if H[0, 0] < 1e-9 or np.linalg.det(H) < 1e-9 * H[0, 0] * H[1, 1]:
        return None
    g = np.array([(weight * slope * r).sum(), -(weight * back * r).sum() - believed * (plate_m - PLATE_M)])
    inverse = np.linalg.inv(H)
    step, thicker = (inverse @ g).tolist()
    spread = 1.4826 * float(np.median(np.abs(r)))
    through = int(seen.through.sum())
    return Fit(
        step,
        float(np.clip(plate_m + thicker, *PLATE_RANGE_M)),
        spread,
        float(use.sum() / max(int(shown.sum()), 1)),
        through / (through + int(use.sum())),
        float(max(spread, 0.0005) ** 2 * CORRELATED_POINTS * inverse[0, 0]),
        float(np.sqrt((weight * slope**2).sum() / weight.sum())),
    )
