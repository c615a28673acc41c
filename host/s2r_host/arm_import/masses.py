"""Mass properties of a URDF's links as those of bodies: put together, and such that a body can have them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from s2r_host.arm_import.urdf_tree import Inertial
from s2r_protocol.arms import ArmDescriptionError

_ROUNDING = 1e-5  # of the largest moment: what a URDF's digits are off, not worth telling
_REPAIRED = 0.05  # of it: what a vendor's estimate may be off and still means this body
_THINNEST = 1e-6  # of it: a rod without thickness has no moment about itself
_MARGIN = 1.0 + 1e-6  # the digits of an arm.yaml


def together(parts: Sequence[tuple[Inertial | None, np.ndarray]]) -> Inertial | None:
    """Bodies that move as one, each with the pose (4, 4) of its frame; None where none has a mass."""
    there = [
        (i.mass, X[:3, 3] + X[:3, :3] @ i.com, X[:3, :3] @ i.inertia @ X[:3, :3].T) for i, X in parts if i
    ]
    if not there:
        return None
    mass = sum(m for m, _, _ in there)
    com = np.sum([m * c for m, c, _ in there], axis=0) / mass
    inertia = np.zeros((3, 3))
    for m, c, moments in there:
        d = c - com
        inertia += moments + m * (float(d @ d) * np.eye(3) - np.outer(d, d))
    return Inertial(mass, com, inertia)


def possible(link: str, inertial: Inertial | None, told: list[str]) -> Inertial:
    """Mass properties that a body can have: the largest principal moment is at most the sum of the other two.

    Where a URDF is off by little, the smaller two are raised, which is told.

    Raises:
        ArmDescriptionError: There is no mass or no inertia, or no body comes near it.
    """
    if inertial is None:
        raise ArmDescriptionError(f"link '{link}' has no mass")
    moments, axes = np.linalg.eigh(inertial.inertia)
    said = ", ".join(f"{v:.4g}" for v in moments)
    if moments[2] <= 0.0 or moments[0] < -_REPAIRED * moments[2]:
        what = (
            "no inertia"
            if not inertial.inertia.any()
            else f"principal moments of inertia {said} kg m² below 0"
        )
        raise ArmDescriptionError(f"link '{link}' has {what}")
    raised = np.maximum(moments, _THINNEST * moments[2])
    raised[:2] *= max(1.0, raised[2] * _MARGIN / raised[:2].sum())
    off = float(np.abs(raised - moments).max() / moments[2])
    if off > _REPAIRED:
        raise ArmDescriptionError(
            f"link '{link}' has principal moments of inertia {said} kg m², which violate the triangle inequality: no "
            "body has one larger than the sum of the others"
        )
    if off <= _ROUNDING and np.count_nonzero(inertial.inertia) == 3:
        return inertial  # along the link's axes: the digits stay those of the URDF
    if off > _ROUNDING:
        told.append(
            f"link '{link}': no body has principal moments of inertia {said} kg m²; the smaller two were raised by up "
            f"to {100.0 * off:.2g} % of the largest"
        )
    return Inertial(inertial.mass, inertial.com, (axes * raised) @ axes.T)
