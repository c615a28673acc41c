"""True parameter values under the names a tool may use for them.

The contract fixes names of effects, not of parameters; so every quantity is offered under its usual names, with
the conversions written out once.
"""

from __future__ import annotations

from typing import Any

import numpy as np

_SAME: dict[str, dict[str, tuple[str, ...]]] = {
    "coulomb_friction": {"friction": ("friction", "level", "coulomb", "frictionloss", "Fc")},
    "viscous_friction": {"damping": ("damping", "coefficient", "viscous", "b")},
    "stribeck": {
        "excess": ("excess", "static_excess", "stribeck", "amplitude"),
        "velocity": ("velocity", "speed", "stribeck_velocity", "vs"),
    },
    "presliding": {"displacement": ("displacement", "presliding_displacement", "width")},
    "asymmetric_friction": {"coulomb_difference": ("coulomb_difference", "difference")},
    "load_dependent_friction": {"coefficient": ("coefficient", "mu", "load_coefficient")},
    "thermal_drift": {"per_kelvin": ("per_kelvin", "temperature_coefficient")},
    "session_friction": {"factor": ("factor", "friction_factor", "scale")},
    "hysteresis": {"torque": ("torque", "level", "amplitude"), "width": ("width", "displacement")},
    "backlash": {"half_width": ("half_width",)},
    "joint_elasticity": {"compliance": ("compliance",), "damping": ("damping",)},
    "motor_coupling": {"inertia": ("inertia", "coupling_inertia")},
    "actuator_delay": {"delay": ("delay", "delay_s")},
    "bandwidth": {"time_constant": ("time_constant", "timeconst", "time_constant_s")},
    "clock_skew": {"delay": ("delay", "delay_s", "skew", "skew_s", "lag")},
    "cogging": {"amplitude": ("amplitude",), "order": ("order",)},
    "cable_spring": {"stiffness": ("stiffness",), "rest": ("rest", "springref")},
    "spring_return": {"stiffness": ("stiffness",), "rest": ("rest", "springref")},
    "detent": {
        "peak": ("peak", "force", "amplitude"),
        "place": ("place", "position", "centre"),
        "width": ("width",),
    },
    "soft_end_stop": {"stiffness": ("stiffness",), "place": ("place", "position", "limit")},
    "soft_close": {"damping": ("damping",), "place": ("place", "position")},
    "armature": {"inertia": ("inertia", "armature")},
    "payload": {"mass": ("mass", "payload_mass")},
    "encoder_eccentricity": {"amplitude": ("amplitude",), "order": ("order",)},
}


def true_values(effect: dict[str, Any]) -> dict[str, float]:
    """Name a tool may use → true value, for one entry of the sealed answers."""
    p = {name: float(entry["value"]) for name, entry in effect["parameters"].items()}
    same = _SAME.get(effect["name"], {})
    found = {alias: p[own] for own, aliases in same.items() for alias in aliases}
    return found | _converted(effect["name"], p)


def _converted(name: str, p: dict[str, float]) -> dict[str, float]:
    match name:
        case "joint_elasticity":
            return {"stiffness": 1.0 / p["compliance"]}
        case "backlash":
            full = 2.0 * p["half_width"]
            return {"width": full, "gap": full}
        case "effort_scale":
            return {
                "scale": 1.0 + p["direction"] * p["deviation"],
                "effort_scale": 1.0 + p["direction"] * p["deviation"],
            }
        case "saturation":
            limit = p["torque_max"] * (1.0 - p["reduction"])
            return {
                "no_load_speed": p["no_load_speed"],
                "limit": limit,
                "torque_limit": limit,
                "effort_limit": limit,
            }
        case "encoder_offset":
            return {"offset": p["direction"] * p["offset"]}
        case "gravity_tilt":
            return {"angle": p["direction"] * p["angle"], "tilt": p["direction"] * p["angle"]}
        case "bandwidth":
            return {"bandwidth_hz": 1.0 / (2.0 * np.pi * p["time_constant"])}
        case _:
            return {}
