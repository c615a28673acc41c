"""Finding hubs whose lever points at the camera: they stand apart on the deck, and no straight piece leads away.

Seen from its end a lever is hardly more than its hub.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_host.motion.knobs import beside_body
from s2r_host.motion.levers import USUAL_WIDTH_M, LeverCandidate
from s2r_host.motion.scene import Scene
from s2r_host.motion.standing import DECK_BAND_M

WIDEST_M, HIGHEST_M = 0.055, 0.06
APART_M = 0.05  # from the body and from what other levers turn about
OUT_M, RISE_M = 0.06, 0.02  # from the hub's top to where the lever is felt for, towards the camera and up


def find_hubs(scene: Scene, taken: Sequence[np.ndarray]) -> list[LeverCandidate]:
    """What may be levers that point at the camera, by their hubs, the one with most points first; maybe none.

    Args:
        scene: Observed points.
        taken: What known levers and knobs turn about [m], (3,) each.
    """
    standing, found = beside_body(scene), []
    if standing is None:
        return []
    deck_m, p_body = standing.deck_m, standing.p_body
    for piece in standing.apart:
        size, middle = np.ptp(piece, axis=0), piece.mean(axis=0)
        away_m = [float(np.linalg.norm(middle[:2] - one[:2])) for one in (p_body, *taken)]
        low = piece[:, 2].min() < deck_m + DECK_BAND_M and size[2] < HIGHEST_M
        if low and max(size[:2]) <= WIDEST_M and min(away_m) >= APART_M:
            found.append(_towards_camera(piece, middle, p_body, scene.p_camera))
    return found


def _towards_camera(
    piece: np.ndarray, middle: np.ndarray, p_body: np.ndarray, p_camera: np.ndarray
) -> LeverCandidate:
    """The lever on a hub (n, 3), as far as it is felt for."""
    outward = (p_camera - middle) * (1.0, 1.0, 0.0)
    outward /= np.linalg.norm(outward)
    p_root = np.append(middle[:2], piece[:, 2].max())
    return LeverCandidate(
        p=piece,
        p_root=p_root,
        p_tip=p_root + OUT_M * outward + np.array([0.0, 0.0, RISE_M]),
        width_m=USUAL_WIDTH_M,
        bend=0.0,
        towards_user=0.0,
        outward=outward,
        above_deck_m=0.0,
        radial=1.0,
        rooted=True,
        p_body=p_body,
    )
