"""Real recordings: what `s2r gap` says about machines it never saw. Prints one table; run by hand or by `make bench`.

Budget: one minute of processor time per machine. EMPS: Janot, Gautier, Brunot, "Data Set and Reference Models of
EMPS" (2019); nominal model = the publisher's four numbers without the offset.
"""

import csv
import json
import os
import tempfile
import time
from pathlib import Path

import yaml

from s2r_host.gap.cli import run_gap

BUDGET_S = 60.0
EMPS_XML = """<mujoco model="emps">
  <option timestep="0.001" integrator="implicitfast"/>
  <worldbody><body name="carriage">
    <joint name="slide" type="slide" axis="1 0 0" damping="203.5034" frictionloss="20.3935"/>
    <inertial mass="95.1089" pos="0 0 0" diaginertia="1 1 1"/>
  </body></worldbody>
</mujoco>
"""


def shared_data() -> Path:
    """Folder of the real recordings."""
    return Path(os.environ.get("S2R_SHARED_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))


def write_emps(folder: Path) -> dict[str, Path]:
    """Both EMPS records as CSV with side files, and the model."""
    from scipy.io import loadmat

    made = {"model": folder / "emps.xml"}
    made["model"].write_text(EMPS_XML, encoding="utf-8")
    for name, session in (("DATA_EMPS", "first"), ("DATA_EMPS_PULSES", "second")):
        mat = loadmat(shared_data() / "emps" / f"{name}.mat")
        gain = float(mat["gtau"].ravel()[0])
        columns = (mat["t"].ravel(), mat["qm"].ravel(), mat["qg"].ravel(), gain * mat["vir"].ravel())
        path = made[name] = folder / f"{name}.csv"
        with path.open("w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream)
            writer.writerow(["t", "q.slide", "q_cmd.slide", "tau.slide"])
            writer.writerows(zip(*[[f"{x:.9g}" for x in c] for c in columns], strict=True))
        side = {"effort": "commanded", "input": "effort", "session": session}
        path.with_suffix(".yaml").write_text(yaml.safe_dump(side), encoding="utf-8")
    return made


def main() -> None:
    """Run EMPS and print what was found."""
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        case = write_emps(folder)
        config = folder / "gap.yaml"
        config.write_text("open_loop_window_s: inf\ncalibrate_s: 5\n", encoding="utf-8")
        started = time.process_time()
        run_gap(case["model"], [case["DATA_EMPS"]], [case["DATA_EMPS_PULSES"]], [], config, folder / "out")
        used = time.process_time() - started
        answer = json.loads((folder / "out" / "gap.json").read_text(encoding="utf-8"))
    print(f"EMPS: {answer['verdict']}, {used:.1f} s of processor time (budget {BUDGET_S:.0f})")
    for e in answer["effects"]:
        values = ", ".join(f"{k} {v['value']:.4g} {v['unit']}" for k, v in e["parameters"].items())
        print(f"  {e['name']:22s} p {e['probability']:.2f}  {values}")
    fit = answer["fit"]
    before, after = fit["open_loop_holdout_before"], fit["open_loop_holdout_after"]
    print(
        f"  whole second record, open loop: {1e3 * before:.2f} -> {1e3 * after:.2f} mm (published numbers: 8.41 mm)"
    )


if __name__ == "__main__":
    main()
