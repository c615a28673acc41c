"""Why no fingertip gets behind a part, in words."""

from __future__ import annotations

import mujoco
import numpy as np

from s2r_host.errors import HostError
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.part_shape import part_geoms
from s2r_host.planning.places import Places
from s2r_host.planning.scene import Scene
from s2r_protocol.exits import RefusedError

_NEAR = 0.5  # of the summed lengths of its links: so near the distance keeps an arm from nothing
_ALONG = 0.6  # cosine between the hand's axis and a direction that it comes along


class OutOfReachError(HostError, RefusedError):
    """The arm cannot get its fingertip to where the part could be pushed."""


class NeverInReachError(OutOfReachError):
    """It will not from any place of the part, nor at any state of it."""


def not_reached(scene: Scene, places: Places, failure: str, nearer_m: float | None) -> str:
    """Why the arm gets at none of the places and what would help, for the middle of a sentence.

    Of places as near as those of a part that can be moved it is not the distance that keeps the arm away, but how the
    hand would have to come: a plain front can be pulled from behind or over its edges only.

    Args:
        scene: The models.
        places: Those behind the part.
        failure: What the arm does not manage there.
        nearer_m: With the object so much nearer to the base it reaches one of them; None: not known.
    """
    nearest_m = float(np.linalg.norm(places.p, axis=1).min())
    if nearest_m > _NEAR * arm_reach_m(scene):
        near = f"nearest place {nearest_m:.2f} m from the base"
        move = (
            "move the object" if nearer_m is None else f"move the object {nearer_m:.2f} m nearer to the base"
        )
        return f"out of reach: the arm {scene.arm.name!r} {failure} ({near}); {move}"
    comes = places.R[:, :, 2]
    behind = np.einsum("ni,ni->n", comes, places.way) > _ALONG
    above = ~behind & (comes[:, 2] < -_ALONG)
    counts = (("its far side", behind), ("above", above), ("aside", ~behind & ~above))
    ways = ", ".join(f"from {name} at {share.mean():.0%}" for name, share in counts if share.any())
    return (
        f"the arm {scene.arm.name!r} {failure} (the hand has to come {ways} of them); "
        "is there a handle, or a free edge on the arm's side?"
    )


def hull_hint(scene: Scene) -> str:
    """What to think of where meshes of the part may have closed the gap, for the end of a sentence."""
    geoms = part_geoms(scene)
    meshes = geoms[scene.fine.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_MESH]
    if not len(meshes):
        return ""
    names = ", ".join(scene.fine.mesh(int(scene.fine.geom_dataid[g])).name for g in meshes[:3])
    return (
        f" (MuJoCo takes each of the part's meshes, {names}{', …' if len(meshes) > 3 else ''}, for its convex hull: a "
        "gap in one needs it split into convex pieces, as CoACD does)"
    )


def refuse_far(scene: Scene, world: FineWorld, name: str) -> None:
    """Refuse a part that no posture of the arm comes near.

    Raises:
        NeverInReachError: Nothing solid to push, or its nearest point is farther than the stretched arm.
    """
    reach_m = arm_reach_m(scene)
    geoms = part_geoms(scene)
    if not len(geoms):
        raise NeverInReachError(
            f"object {name}: the part that joint {scene.joint!r} moves has no solid geom to push"
        )
    away = np.linalg.norm(world.data.geom_xpos[geoms], axis=1) - scene.fine.geom_rbound[geoms]
    if away.min() > reach_m:
        raise NeverInReachError(
            f"object {name}: out of reach: the part is {away.min():.2f} m or more from the base of arm "
            f"{scene.arm.name!r}, which reaches {reach_m:.2f} m at most; move the object"
        )


def arm_reach_m(scene: Scene) -> float:
    """Length of the stretched arm, an upper bound."""
    source = scene.arm.source
    offsets = [link.origin for link in (*source.joints, *source.mounts)] + [source.tool.origin]
    return float(sum(np.linalg.norm(offset) for offset in offsets))
