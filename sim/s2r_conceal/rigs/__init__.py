"""The machines that recordings come from; one file per rig."""

from s2r_conceal.rigs.base import Dynamics, Rig, rig_named

__all__ = ["Dynamics", "Rig", "rig_named"]
