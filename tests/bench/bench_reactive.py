"""Reactive mode in the fine model: `python tests/bench/bench_reactive.py` prints errors with and without looking.

The true object stands 4 mm beside the believed one, with other friction and damping; the arm follows its motions
exactly. What the executor adds is tested in tests/integration/test_reactive_stand_in.py.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from s2r_host.planning import PlanRequest, PlanSettings
from s2r_host.planning.belief import Belief
from s2r_host.planning.bench.tasks import draw_task
from s2r_host.planning.execution import FineWorld
from s2r_host.planning.planner import scene_of
from s2r_host.planning.scene import Scene
from s2r_host.trajectory import Trajectory, plan_trajectory
from s2r_host.trajectory.reactive import Outlook, ReactivePlanner
from s2r_protocol.arms import load_arm

ARM = load_arm("xmate3pro")
STEP_S, STEPS_PER_LOOK, LONGEST_STEPS = 0.05, 4, 600


@dataclass
class Played:
    error: float = 0.0
    contact: str | None = None
    splices: int = 0
    looks: list[Outlook] = field(default_factory=list)


def play(
    request: PlanRequest, scene: Scene, truth: Belief, motion: Trajectory, planner: ReactivePlanner | None
) -> Played:
    """Play a motion on the true object; with a planner, look at its future five times a second."""
    world, played = FineWorld(truth.applied(scene), ARM.q_home, request.s_initial), Played()
    gain = request.settings.servo.kd / request.settings.servo.kp
    dt, t = request.settings.fine_timestep_s, 0.0
    coming: tuple[float, Trajectory] | None = None
    if planner is not None:
        planner.begin(motion)
    for step in range(LONGEST_STEPS):
        if coming is not None and t >= coming[0] - 1e-9:
            t, motion, coming = t - coming[0], coming[1], None
        q, dq, _ = motion.sample(t + dt * np.arange(1, round(STEP_S / dt) + 1))
        played.contact = played.contact or world.play(q + gain * dq).contact
        t += STEP_S
        if planner is not None and coming is None and step % STEPS_PER_LOOK == 0:
            look = planner.look(motion, t, world.s)
            played.looks.append(look)
            if look.motion is not None:
                planner.accept(look)
                played.splices += 1
                coming = look.splice_t, look.motion
                if t >= motion.duration_s:
                    t, motion, coming = 0.0, look.motion, None
        ended = coming is None and t > motion.duration_s + 0.5
        if ended and (planner is None or played.looks[-1].motion is None):
            break
    played.error = request.s_target - world.s
    return played


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--tasks", default="drawer_open,drawer_close,laptop_open,laptop_close,faucet_left")
    parser.add_argument("--placement", type=int, default=0)
    parser.add_argument("--collection", type=int, default=0)
    options = parser.parse_args()
    print("| task | error without | error with | splices | looks | CPU of a look p50, max, ms | contact |")
    print("|---|---|---|---|---|---|---|")
    for name in options.tasks.split(","):
        task = draw_task(name, options.placement, options.collection)
        with tempfile.TemporaryDirectory() as folder:
            path = task.write(Path(folder))
            request = PlanRequest(
                ARM, path, s_initial=task.s_initial, s_target=task.s_target, q_initial=ARM.q_home,
                settings=PlanSettings(threads=1),
            )  # fmt: skip
            scene = scene_of(request)
            result, delivery = plan_trajectory(request, scene=scene, accept_fragile=True)
        truth = Belief((-0.004 if name == "drawer_open" else 0.004, 0.002, 0.0), 1.3, 1.5, 1.4)
        planner = ReactivePlanner(request, scene, result.hook)
        blind = play(request, scene, truth, delivery.trajectory, None)
        seeing = play(request, scene, truth, delivery.trajectory, planner)
        cpu_ms = [1e3 * look.cpu_s for look in seeing.looks]
        print(
            f"| {name} | {blind.error:+.4f} | {seeing.error:+.4f} | {seeing.splices} | {len(cpu_ms)} | "
            f"{np.median(cpu_ms):.0f}, {max(cpu_ms):.0f} | {seeing.contact or 'none'} |"
        )


if __name__ == "__main__":
    main()
