"""Banded rotary friction device with backlash: Coble, Huggins, Cao, Ricles, Downey (2022), CC-BY-SA-4.0.

Imposed displacement (inches) and measured friction force (kip). Nominal model: the moving mass with Coulomb friction.
"""

from pathlib import Path

import numpy as np

from .case import Case, Check, effect, named, shared_data, within, write_recording
from .page import Page

XML = """<mujoco model="friction_device">
  <worldbody><body name="band">
    <joint name="stroke" type="slide" axis="1 0 0" frictionloss="9000"/>
    <inertial mass="20" pos="0 0 0" diaginertia="1 1 1"/>
  </body></worldbody>
</mujoco>
"""
PAGE = Page(
    title="Rotary friction device with play",
    source=(
        "Coble, Huggins, Cao, Ricles and Downey (2022), "
        "[Dataset-Friction-Damper-with-Backlash]"
        "(https://github.com/ARTS-Laboratory/Dataset-Friction-Damper-with-Backlash)."
    ),
    licence="CC-BY-SA-4.0.",
    known=(
        "A band brake moved to and fro by a test stand, force and way measured at 1024 Hz.\n"
        "At each reversal the friction comes only after some play; the band tightens itself in one direction."
    ),
    given="A mass with dry friction as model; two recordings, each on its own, the last 30 % of each held out.",
    missed=(
        "The R² of force at 1 Hz: it was 0.957 until the timing of effort against motion was let free within its "
        "doubt.\n"
        "What the rest of that force is, is not known."
    ),
)


def cases(folder: Path) -> list[Case]:
    """Both recordings apart; the last 30 % of each is held out."""
    model = folder / "brfd.xml"
    model.write_text(XML, encoding="utf-8")
    found = []
    for name in ("d1_1Hz_35lb", "d2_0.5Hz_30lb_1in"):
        data = np.load(shared_data() / "brfd_friction_backlash" / f"{name}.npz")["data"].astype(float)
        columns = {"t": data[:, 0], "q.stroke": data[:, 1], "dq.stroke": data[:, 3], "tau.stroke": data[:, 2]}
        side = {
            "effort": "measured", "input": "effort", "units": {"q": "in", "dq": "in/s", "tau": "kip"},
            "session": name,
        }  # fmt: skip
        record = write_recording(folder / f"{name.split('_')[0]}.csv", columns, side)
        spread = float(np.std(data[int(0.7 * len(data)) :, 2])) * 4448.2216
        found.append(Case(f"brfd_{record.stem}", model, [record], lambda a, spread=spread: _judge(a, spread)))
    return found


def _judge(a: dict, spread: float) -> list[Check]:
    left = a["fit"].get("effort_holdout_after")
    play = effect(a, "backlash")
    return [
        named(a, "play at each reversal", "backlash"),
        Check("not Stribeck", "named" if effect(a, "stribeck") else "not named", effect(a, "stribeck") is None),
        within("held-out R² of force >= 0.985", None if left is None else 1 - (left / spread) ** 2, 0.985, 1, ""),
        Check("half width 2.4 mm (own fit of a series play)",
              "absent" if play is None else f"{1e3 * play['parameters']['half_width']['value']:.3g} mm",
              play is not None and 1.5e-3 < play["parameters"]["half_width"]["value"] < 4e-3),
    ]  # fmt: skip
