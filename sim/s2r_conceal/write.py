"""Writing one case as neutral files: ``model.xml`` and three tables with a YAML beside each."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml

from s2r_conceal.cases import Case, machine_of_the_file, with_parameters_off
from s2r_conceal.mjcf import numbers
from s2r_conceal.plant import Active
from s2r_conceal.record import Recorded, Recording


def write_case(folder: Path, recorded: Recorded) -> None:
    """Write every file the tool may read for one case."""
    folder.mkdir(parents=True, exist_ok=True)
    case = recorded.case
    (folder / "model.xml").write_text(model_file(case))
    for role, recording in recorded.recordings.items():
        (folder / f"{role}.csv").write_text(table_text(case, recording))
        (folder / f"{role}.yaml").write_text(yaml.safe_dump(sidecar(case, role), sort_keys=False))


def model_file(case: Case) -> str:
    """The MJCF: stated values, plus the effects that are built into it."""
    attributes: list[dict[str, str]] = [{"stiffness": "0", "springref": "0"} for _ in case.rig.joint_names]
    for active in case.in_model:
        attributes[active.joint] |= _attributes(active)
    return case.rig.mjcf(machine_of_the_file(case), attributes)


def _attributes(active: Active) -> dict[str, str]:
    v = active.values
    match active.name:
        case "spring_return":
            return {"stiffness": f"{v['stiffness']:.7g}", "springref": f"{v['rest']:.7g}"}
        case "saturation":
            limit = v["torque_max"] * (1.0 - v["reduction"])
            return {"actuatorfrcrange": numbers([-limit, limit])}
        case _:
            return {}


def columns_of(case: Case) -> list[tuple[str, str]]:
    """(column prefix, field of ``Recording``) in file order; depends on the mask alone."""
    found = [("q", "q"), ("dq", "dq")]
    if not case.mask.no_effort:
        found.append(("tau", "tau"))
    found += [("q_cmd", "q_cmd"), ("dq_cmd", "dq_cmd")]
    if not case.mask.no_effort:
        found.append(("tau_ff", "tau_ff"))
    if case.mask.with_temperature:
        found.append(("temp", "temp_C"))
    return found


def table_text(case: Case, recording: Recording) -> str:
    """The table as CSV with seven digits."""
    columns = columns_of(case)
    header = ["t"] + [f"{prefix}.{joint}" for prefix, _ in columns for joint in case.rig.joint_names]
    data = np.concatenate([recording.t[:, None], *(getattr(recording, f) for _, f in columns)], axis=1)
    row = ",".join(["%.6f"] + ["%.7g"] * (data.shape[1] - 1))
    return "\n".join([",".join(header), *(row % tuple(values) for values in data.tolist())]) + "\n"


def sidecar(case: Case, role: str) -> dict[str, object]:
    """What the YAML says: controller, kind of effort, input, session."""
    _, controller = with_parameters_off(case)
    names = case.rig.joint_names
    if case.mask.no_effort:
        stated: dict[str, object] = {"type": "position_servo"}
    elif case.mask.no_law:
        stated = {"type": "none"}
    else:
        stated = {"type": "pid" if controller.ki.any() else "pd", "rate_hz": controller.rate_hz}
        for gain in ("kp", "kd", "ki"):
            values = getattr(controller, gain)
            stated[gain] = {n: float(v) for n, v in zip(names, values, strict=True)}
    described: dict[str, object] = {"controller": stated, "input": "effort" if case.mask.no_law else "q_cmd"}
    if not case.mask.no_effort:
        described["effort"] = "measured" if case.mask.measured_effort else "commanded"
    described["joint_names"] = {n: n for n in names}
    described["session"] = case.sessions[role]
    described["notes"] = "starts at rest; the controller's integral starts at zero with the recording"
    return described
