"""UR10e, motor currents: Mamedov and Mikhel, "Practical Aspects of Model-Based Collision Detection" (2020).

Drive gains and the mass of the load (2.805 kg) as in the publisher's scripts; link masses and centres
from the manufacturer's data sheet of the series.
First the unloaded runs, then a loaded one on the model patched by the first answer.
"""

from pathlib import Path

import numpy as np

from .case import Case, Check, effect, shared_data, within, write_recording
from .page import Page

GAINS = (14.87, 13.26, 11.13, 10.62, 11.03, 11.47)
D = (0.1807, 0.0, 0.0, 0.17415, 0.11985, 0.11655)
A = (0.0, -0.6127, -0.57155, 0.0, 0.0, 0.0)
ALPHA = (np.pi / 2, 0.0, 0.0, np.pi / 2, -np.pi / 2, 0.0)
MASS = (7.369, 13.051, 3.989, 2.1, 1.98, 0.615)
COM = (
    (0.021, 0, 0.027),
    (0.38, 0, 0.158),
    (0.24, 0, 0.068),
    (0, 0.007, 0.018),
    (0, 0.007, 0.018),
    (0, 0, -0.026),
)
RADIUS = (0.08, 0.075, 0.06, 0.05, 0.05, 0.045)
PAGE = Page(
    title="UR10e",
    source=(
        'Mamedov and Mikhel, "Practical Aspects of Model-Based Collision Detection" (Frontiers in Robotics and AI '
        "2020), "
        "[dynamic_calibration](https://github.com/shamilmamedov/dynamic_calibration)."
    ),
    licence="none stated: measured here, not passed on.",
    known=(
        "Six joints, motor currents at 100 Hz; drive gains from the publisher.\n"
        "Unloaded on two days, and once with a load of 2.805 kg on the flange."
    ),
    given=(
        "An arm from the data sheet's table, without friction, links as rods. The unloaded run to fit and the other "
        "day's held out; then the loaded run on the model that the first answer patched."
    ),
    missed=(
        "Nothing that was asked for. Beside it the answers name friction that grows with load, or a changed friction, "
        "which nobody measured there."
    ),
)


def arm_xml() -> str:
    """The arm from its Denavit-Hartenberg table; link inertias are those of rods of the link's length."""
    text = ['<mujoco model="ur10e"><compiler angle="radian"/><worldbody>']
    where = 'pos="0 0 0"'
    for k in range(6):
        c, s = np.cos(ALPHA[k]), np.sin(ALPHA[k])
        R = np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
        com = np.array([A[k], 0, D[k]]) + R @ np.array(COM[k])
        rod = MASS[k] * np.hypot(A[k], D[k]) ** 2 / 12
        core = MASS[k] * RADIUS[k] ** 2 / 2
        text.append(
            f'<body name="link{k + 1}" {where}><joint name="joint{k + 1}" axis="0 0 1" range="-6.2832 6.2832"/>'
            f'<inertial mass="{MASS[k]}" pos="{com[0]:.5f} {com[1]:.5f} {com[2]:.5f}" '
            f'diaginertia="{core:.5f} {core + rod:.5f} {core + rod:.5f}"/>'
        )
        half = ALPHA[k] / 2
        where = f'pos="{A[k]} 0 {D[k]}" quat="{np.cos(half):.6f} {np.sin(half):.6f} 0 0"'
    return "".join(text) + "</body>" * 6 + "</worldbody></mujoco>\n"


def cases(folder: Path) -> list[Case]:
    """Unloaded, then loaded."""
    model = folder / "ur10e.xml"
    model.write_text(arm_xml(), encoding="utf-8")
    free = _record(folder, "20_02_19_14harm50sec", "free")
    other = _record(folder, "20_02_12-50sec_12harm", "other_day")
    loaded = _record(folder, "20_02_19_14harm50secLoad", "loaded")
    return [
        Case("ur10e_free", model, [free], _judge_free, [other]),
        Case("ur10e_loaded", model, [loaded], _judge_loaded, after="ur10e_free"),
    ]


def _record(folder: Path, name: str, label: str) -> Path:
    data = np.load(shared_data() / "ur10e" / f"{name}.npz")
    columns = {"t": data["t"]}
    for k in range(6):
        columns[f"q.joint{k + 1}"] = data["q"][:, k]
        columns[f"dq.joint{k + 1}"] = data["dq"][:, k]
        columns[f"tau.joint{k + 1}"] = GAINS[k] * data["i"][:, k]
    side = {"effort": "measured", "input": "effort", "session": label}
    return write_recording(folder / f"ur10e_{label}.csv", columns, side)


def _judge_free(a: dict) -> list[Check]:
    friction = sorted(
        {e["joint"] for e in a["effects"] if "friction" in e["name"] or e["name"] == "stribeck"}
    )
    return [
        Check("friction on every joint", ", ".join(friction) or "none", len(friction) >= 5),
        Check(
            "no payload",
            "payload named" if effect(a, "payload") else "not named",
            effect(a, "payload") is None,
        ),
    ]


def _judge_loaded(a: dict) -> list[Check]:
    """A payload counts in either list of the answer."""
    named = [(e["name"], e["parameters"].get("mass")) for e in a["effects"]]
    named += [(p["name"], {"value": p["to"]}) for p in a["parameters_off"]]
    first = named[0][0] if named else "none"
    mass = next((m["value"] for n, m in named if n in ("payload", "payload_mass") and m), None)
    return [
        Check("payload named first", first, first in ("payload", "payload_mass")),
        within("mass 2.805 kg within 5 %", mass, 0.95 * 2.805, 1.05 * 2.805, "kg"),
    ]
