"""Open-robot actuator motor (brushless, direct drive) at constant command: cogging, BSD-3-Clause.

Torque from the phase current with the motor's nominal constant. Nominal model: the rotor as a ring of 25 g at 20 mm,
without friction.
"""

from pathlib import Path

import numpy as np

from .case import Case, Check, effect, named, shared_data, within, write_recording
from .page import Page

TORQUE_CONSTANT = 0.0318  # N·m/A: 300 rpm/V by the data sheet of the kit's motor (4004 size)
XML = """<mujoco model="motor">
  <worldbody><body name="rotor">
    <joint name="shaft" type="hinge" axis="0 0 1" damping="0.0001"/>
    <inertial mass="0.05" pos="0 0 0" diaginertia="0.000006 0.000006 0.00001"/>
  </body></worldbody>
</mujoco>
"""
PAGE = Page(
    title="Motor of the open robot actuator",
    source="LAAS, [heitor-andrade/laas_anti_cogging](https://github.com/heitor-andrade/laas_anti_cogging).",
    licence="BSD-3-Clause.",
    known=(
        "A brushless motor without load turns at one turn per second under speed control, 1 kHz.\n"
        "Measured by hand: the current follows the rotor with order 72 per turn, 0.18 to 0.25 A."
    ),
    given=(
        "A ring of 25 g as rotor, without friction; the torque is the current times the data sheet's constant. One "
        "recording, its last 30 % held out."
    ),
)


def cases(folder: Path) -> list[Case]:
    """Speed control at one turn per second, the state in which the speed is even."""
    model = folder / "laas.xml"
    model.write_text(XML, encoding="utf-8")
    path = shared_data() / "laas_cogging" / "speed_test.txt"
    data = np.genfromtxt(path, delimiter=",", names=True, dtype=float)
    even = data["Function_Activated"] == 0
    t = data["Time"][even]
    columns = {
        "t": t - t[0],
        "q.shaft": data["Position"][even],
        "dq.shaft": data["Velocity"][even],
        "tau.shaft": TORQUE_CONSTANT * data["Iq"][even],
        "current.shaft": data["Iq"][even],
    }
    record = write_recording(
        folder / "laas_even.csv", columns, {"effort": "measured", "input": "effort", "session": "even"}
    )
    return [Case("laas", model, [record], _judge)]


def _judge(a: dict) -> list[Check]:
    e = effect(a, "cogging")
    order = e["parameters"]["order"]["value"] if e else None
    size = e["parameters"]["amplitude"]["value"] / TORQUE_CONSTANT if e else None
    return [
        named(a, "cogging", "cogging"),
        within("order 72 per turn", order, 71.9, 72.1, "1/rev"),
        within("0.18 to 0.25 A", size, 0.15, 0.3, "A"),
    ]
