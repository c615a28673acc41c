"""The pairs of links of an arm that are to be kept apart, ready to be measured."""

from __future__ import annotations

import pinocchio as pin

from s2r_protocol.arms.description import ArmDescription


def link_pairs(arm: ArmDescription) -> tuple[pin.Model, pin.GeometryModel, list[tuple[str, str]]]:
    """Model, shapes with their collision pairs, and the two links of each, in the order of the pairs.

    Neighbours and what ``collision_exclude`` names are not among them.
    """
    model = pin.buildModelFromXML(arm.urdf)
    shapes = pin.buildGeomFromUrdfString(model, arm.urdf, pin.GeometryType.COLLISION)
    links = [model.frames[shape.parentFrame].name for shape in shapes.geometryObjects]
    excluded = {frozenset(pair) for pair in arm.collision_exclude}
    pairs = []
    for i, first in enumerate(links):
        for j, second in enumerate(links[:i]):
            if first != second and frozenset((first, second)) not in excluded:
                shapes.addCollisionPair(pin.CollisionPair(j, i))
                pairs.append((second, first))
    return model, shapes, pairs
