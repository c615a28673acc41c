"""DFKI torque-limited simple pendulum (AK80-6 drive), BSD-3-Clause.

Nominal model: the publisher's inertia, first moment and viscous friction, without the Coulomb part.
"""

from pathlib import Path

import numpy as np

from .case import Case, Check, named, shared_data, within, write_recording
from .page import Page

XML = """<mujoco model="pendulum">
  <option timestep="0.001"/>
  <worldbody><body name="rod">
    <joint name="pivot" type="hinge" axis="0 -1 0" damping="0.04707"{more}/>
    <inertial mass="0.2044" pos="0 0 -0.5" diaginertia="0.01149 0.01149 0.0001"/>
  </body></worldbody>
</mujoco>
"""
PAGE = Page(
    title="Pendulum of the DFKI",
    source=(
        "[torque_limited_simple_pendulum]"
        "(https://github.com/dfki-ric-underactuated-lab/torque_limited_simple_pendulum), a quasi-direct drive AK80-6."
    ),
    licence="BSD-3-Clause.",
    known=(
        "A rod with a bob; published are inertia, first moment, viscous friction 0.047 N·m·s/rad and dry friction "
        "0.18 N·m.\n"
        "Another run has another bob."
    ),
    given=(
        "The published numbers without the dry friction and the 3.9 s of the identification run; then the run with the "
        "other bob on a model that has the friction. The last 30 % of each is held out."
    ),
    missed=(
        "Dry friction: the torque, mostly the drive's answer to noise, jumps by up to 17 N·m from row to row. Below "
        "the 5 Hz where motion and effort can be compared 40 rows remain, whose noise is as large as what the model "
        "leaves over."
    ),
)


def cases(folder: Path) -> list[Case]:
    """Identification run; and a run with another bob, on a model that has the published friction."""
    plain, full = folder / "dfki.xml", folder / "dfki_friction.xml"
    plain.write_text(XML.replace("{more}", ""), encoding="utf-8")
    full.write_text(XML.replace("{more}", ' frictionloss="0.1839"'), encoding="utf-8")
    return [
        Case("dfki_friction", plain, [_record(folder, "pd_system_identification")], _judge),
        Case("dfki_bob", full, [_record(folder, "energy_shaping_1kg")], _judge_bob),
    ]


def _record(folder: Path, name: str) -> Path:
    data = np.genfromtxt(
        shared_data() / "dfki_simple_pendulum" / f"{name}.csv", delimiter=",", names=True, dtype=float
    )
    t = data["time"]
    keep = np.concatenate([[True], np.diff(t) > 0])
    columns = {
        "t": t[keep], "q.pivot": data["position"][keep], "dq.pivot": data["velocity"][keep],
        "tau.pivot": data["torque"][keep],
    }  # fmt: skip
    return write_recording(
        folder / f"{name}.csv", columns, {"effort": "measured", "input": "effort", "session": name}
    )


def _judge(a: dict) -> list[Check]:
    fit = a["fit"]
    error = fit.get("open_loop_holdout_after")
    return [
        named(a, "dry friction (Coulomb 0.18 N·m, with a low-speed part)", "coulomb_friction", "stribeck",
              "presliding", "asymmetric_friction", "load_dependent_friction"),
        within("1 s windows, rms <= 0.044 rad (refit of the published structure)", error, 0, 0.044, "rad"),
    ]  # fmt: skip


def _judge_bob(a: dict) -> list[Check]:
    off = [p for p in a["parameters_off"] if p["name"].startswith(("mass", "com"))]
    e = next((e for e in a["effects"] if e["name"] == "payload"), None)
    text = f"payload {e['parameters']['mass']['value']:.3g} kg" if e else f"{[p['name'] for p in off]}"
    return [Check("another bob: payload or mass", text, e is not None or bool(off))]
