"""Seven joints at a glance: one thing hidden in the shipped arm, what `s2r gap` says, and how long it takes.

    python tests/bench/bench_gap_arm.py --out DIR [--only payload,cogging] [--seed 3] [--duration 10] [--full]

Recordings are made in MuJoCo at 5 kHz with a PD controller at 1 kHz and 250 rows per second, so that a case costs
seconds; the tool simulates with MuJoCo too, which makes this a check of names and places while working on the tool and
no proof: proofs are drawn by `s2r conceal draw --rig seven_joint`. Link masses in the model are off by up to 1 %.
Budget: 10 minutes per case on two cores.
"""

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import yaml

from s2r_conceal.motions import derivatives, rich
from s2r_conceal.parameters import Machine
from s2r_conceal.rigs import rig_named
from s2r_conceal.setting import misjudged
from s2r_host.gap.cli import run_gap

JOINTS = 7
FINE = 5  # steps per tick of 1 ms
ROWS_EVERY = 4
BANDWIDTH = 25.0  # of the position loop [rad/s]
LIGHT = 0.2  # motor inertia of an arm as descriptions come
DISTURBANCE = np.array([0.2, 0.4, 0.15, 0.2, 0.06, 0.06, 0.03])  # [N·m]
NAMES_ONLY = "simulate: false\nbaselines: false\nreport: false\nnext_experiment: false\n"


@dataclass(frozen=True)
class Hidden:
    """What one case hides: in the bodies, in the compiled model, in the effort or in the sensor.

    Attributes:
        right: Answers that are right: names of effects, or a verdict.
        joint: Joint of the effect, 0 where it has none.
        bare: No friction and little motor inertia anywhere, as descriptions come.
        effort: Effort beside the commanded one [N·m], from time, position and the commanded efforts so far.
    """

    right: tuple[str, ...]
    joint: int = 0
    bare: bool = False
    machine: Callable[[Machine], Machine] = lambda m: m
    model: Callable[[mujoco.MjModel], None] = lambda m: None
    effort: Callable[[float, np.ndarray, list[np.ndarray]], np.ndarray] = lambda t, q, u: np.zeros(JOINTS)
    offset: np.ndarray | None = None


def _on(joint: int, value: float) -> np.ndarray:
    out = np.zeros(JOINTS)
    out[joint - 1] = value
    return out


def _rub(m: mujoco.MjModel) -> None:
    m.dof_frictionloss[2] += 0.8


def _spring(m: mujoco.MjModel) -> None:
    m.jnt_stiffness[3], m.qpos_spring[3] = 6.0, 0.2


def _late(t: float, q: np.ndarray, u: list[np.ndarray]) -> np.ndarray:
    return _on(2, u[max(len(u) - 9, 0)][1] - u[-1][1])


def _tilted(m: Machine) -> Machine:
    return replace(m, gravity=9.81 * np.array([np.sin(0.02), 0.0, -np.cos(0.02)]))


CASES = {
    "clean": Hidden(("nothing_missing",)),
    "clean_bare": Hidden(("nothing_missing",), bare=True),
    "friction": Hidden(("coulomb_friction",), 3, bare=True, model=_rub),
    "payload": Hidden(
        ("payload", "payload_mass"), 7, bare=True,
        machine=lambda m: m.with_point_mass(6, 0.5, np.array([0.0, 0.0, 0.2])),
    ),
    "cogging": Hidden(("cogging",), 5, effort=lambda t, q, u: _on(5, -0.5 * np.sin(20.0 * q[4] + 0.5))),
    "offset": Hidden(("encoder_offset",), 4, offset=_on(4, 0.02)),
    "tilt": Hidden(("gravity_tilt",), machine=_tilted),
    "spring": Hidden(("spring_return", "cable_spring"), 4, bare=True, model=_spring),
    "delay": Hidden(("actuator_delay",), 2, bare=True, effort=_late),
    "unknown": Hidden(("unknown",), 6, effort=lambda t, q, u: _on(6, 0.6 * np.sin(2.0 * np.pi * 3.1 * t))),
}  # fmt: skip


def make(folder: Path, hidden: Hidden, seed: int, duration_s: float) -> None:
    """Model and three recordings of one case."""
    rig, rng = rig_named("seven_joint"), np.random.default_rng(seed)
    folder.mkdir(parents=True, exist_ok=True)
    machine = rig.draw(rng)
    if hidden.bare:
        nothing = np.zeros(JOINTS)
        machine = replace(machine, coulomb=nothing, viscous=nothing, armature=LIGHT * machine.armature)
    told = misjudged(rng, machine, 0.01)
    (folder / "model.xml").write_text(rig.mjcf(told, [{}] * JOINTS), encoding="utf-8")
    true = mujoco.MjModel.from_xml_string(rig.mjcf(hidden.machine(machine), [{}] * JOINTS))
    true.opt.timestep = 1e-3 / FINE
    true.dof_solref[:], true.dof_solimp[:] = (0.001, 1.0), (0.9999, 0.9999, 0.001, 0.5, 2.0)
    hidden.model(true)
    centre, half = rig.stroke(rng)
    inertia = np.diag(rig.dynamics([machine]).mass_matrix(centre[None])[0]) + machine.armature
    for name, motion, noise in (("fit", 1, 1), ("repeat", 1, 2), ("holdout", 2, 3)):
        way = np.random.default_rng([seed, motion])
        q_cmd = centre + half * np.stack([rich(way, duration_s) for _ in range(JOINTS)], axis=1)
        dq_cmd, ddq_cmd = derivatives(q_cmd)
        ahead = rig.inverse_dynamics(told, q_cmd, dq_cmd, ddq_cmd)
        rows = _simulate(
            true, hidden, inertia, (q_cmd, dq_cmd, ahead), np.random.default_rng([seed, 9, noise])
        )
        _write(folder / f"{name}.csv", rows, inertia, rig.joint_names)


def _simulate(
    model: mujoco.MjModel, hidden: Hidden, inertia: np.ndarray,
    command: tuple[np.ndarray, np.ndarray, np.ndarray], rng: np.random.Generator,
) -> np.ndarray:  # fmt: skip
    q_cmd, dq_cmd, ahead = command
    d = mujoco.MjData(model)
    d.qpos[:] = q_cmd[0]
    shift = np.zeros(JOINTS) if hidden.offset is None else hidden.offset
    push, asked, rows = np.zeros(JOINTS), [], []
    for k in range(len(q_cmd)):
        q = np.round((d.qpos + shift + rng.normal(0.0, 2e-5, JOINTS)) / 5e-5) * 5e-5
        dq = d.qvel + rng.normal(0.0, 1e-3, JOINTS)
        u = inertia * (BANDWIDTH**2 * (q_cmd[k] - q) + 2.0 * BANDWIDTH * (dq_cmd[k] - dq)) + ahead[k]
        asked.append(u)
        push = 0.99 * push + 0.14 * DISTURBANCE * rng.normal(size=JOINTS)
        if k % ROWS_EVERY == 0:
            rows.append(np.concatenate([[k * 1e-3], q, dq, u, q_cmd[k], dq_cmd[k], ahead[k]]))
        for _ in range(FINE):
            d.qfrc_applied[:] = u + push + hidden.effort(k * 1e-3, d.qpos, asked)
            mujoco.mj_step(model, d)
    return np.array(rows)


def _write(path: Path, rows: np.ndarray, inertia: np.ndarray, joints: tuple[str, ...]) -> None:
    kinds = ("q", "dq", "tau", "q_cmd", "dq_cmd", "tau_ff")
    head = ",".join(["t", *(f"{kind}.{j}" for kind in kinds for j in joints)])
    np.savetxt(path, rows, delimiter=",", header=head, comments="", fmt="%.7g")
    gains = {"kp": BANDWIDTH**2 * inertia, "kd": 2.0 * BANDWIDTH * inertia}
    law = {name: {j: float(x) for j, x in zip(joints, values, strict=True)} for name, values in gains.items()}
    told = {"controller": {"type": "pd", "rate_hz": 1000, **law}, "effort": "commanded", "input": "q_cmd"}
    path.with_suffix(".yaml").write_text(yaml.safe_dump(told), encoding="utf-8")


def main() -> None:
    """Make, run, print one line per case."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--only", default=",".join(CASES), help="comma-separated cases")
    parser.add_argument("--seed", type=int, default=3)
    parser.add_argument("--duration", type=float, default=10.0)
    parser.add_argument("--full", action="store_true", help="with forward simulation, baselines, report")
    arguments = parser.parse_args()
    if unknown := [name for name in arguments.only.split(",") if name not in CASES]:
        parser.error(f"--only names '{unknown[0]}'; cases are {', '.join(CASES)}")
    arguments.out.mkdir(parents=True, exist_ok=True)
    config = arguments.out / "gap.yaml"
    config.write_text("" if arguments.full else NAMES_ONLY, encoding="utf-8")
    right = 0
    for name in arguments.only.split(","):
        hidden, folder = CASES[name], arguments.out / name
        make(folder, hidden, arguments.seed, arguments.duration)
        fit, held, again = ([folder / f"{role}.csv"] for role in ("fit", "holdout", "repeat"))
        begun = time.process_time()
        run_gap(folder / "model.xml", fit, held, again, config, folder / "out", quiet=True)
        spent = time.process_time() - begun
        gap = json.loads((folder / "out" / "gap.json").read_text(encoding="utf-8"))
        said = (
            [e["name"] for e in gap["effects"]]
            or [p["name"] for p in gap["parameters_off"]]
            or [gap["verdict"]]
        )
        joint = (
            gap["effects"][0]["joint"] if gap["effects"] else (gap["where"] or [{"joint": "-"}])[0]["joint"]
        )
        good = said[0] in hidden.right and (not hidden.joint or joint == f"joint{hidden.joint}")
        right += good
        verdict = "right" if good else "WRONG"
        print(f"{name:12} {verdict}  {', '.join(said)} at {joint}; {spent:.0f} s of one core", flush=True)
    print(f"{right} of {len(arguments.only.split(','))} right")


if __name__ == "__main__":
    main()
