"""Which command lives where. Strings only: nothing here is imported until it is called.

Host, executor and stand-in are independent packages; this table is the one place that names them together.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Command:
    """One subcommand of ``s2r``.

    Attributes:
        target: ``module:attribute`` of a click command.
        extra: The optional install it needs; empty for the base install.
        summary: One line for ``s2r --help``.
    """

    target: str
    extra: str
    summary: str


COMMANDS: dict[str, Command] = {
    "demo": Command(
        "s2r_sim.demo.cli:demo", "host,sim", "Open a never-seen drawer end to end on the stand-in."
    ),
    "doctor": Command(
        "s2r_protocol.cli.doctor:doctor", "", "Check this machine, or an arm description of yours."
    ),
    "import-arm": Command(
        "s2r_host.cli_import_arm:import_arm", "host", "Write a first arm.yaml from the URDF of an arm."
    ),
    "executor": Command("s2r_executor.cli:executor", "", "Admit plans and stream setpoints to the drives."),
    "sim-arm": Command("s2r_sim.cli:sim_arm", "sim", "The stand-in: arm, object, drives, bus and camera."),
    "world": Command("s2r_sim.cli:world", "sim", "Draw and commit to hidden worlds for the stand-in."),
    "data": Command("s2r_sim.cli_data:data", "sim", "Make training data from procedural objects."),
    "train": Command("s2r_host.learn.cli:train", "host,learn", "Train the networks of perception."),
    "run": Command("s2r_host.cli:run", "host", "Perceive, build, plan and execute one manipulation."),
    "plan": Command(
        "s2r_host.cli_plan:plan", "host", "Plan through contact on any MJCF scene, in simulation."
    ),
    "build-model": Command(
        "s2r_host.model.cli:build_model", "host", "Two depth views in, a physics model (URDF, MJCF) out."
    ),
    "console": Command(
        "s2r_host.console.cli:console", "host,console", "The operator's page: see, stop, replay."
    ),
    "replay": Command(
        "s2r_host.cli_replay:replay", "host", "Send a recorded plan again and overlay both recordings."
    ),
    "ros2": Command("s2r_host.ros2.cli:ros2", "ros2", "Take motions from ROS 2 nodes, through admission."),
    "view": Command(
        "s2r_host.log.cli_view:view", "host,console", "Look at a recording, in Rerun or a browser."
    ),
    "log": Command("s2r_host.log.cli:log", "host", "Check, mend, export and compare recordings."),
    "gap": Command("s2r_host.gap.cli:gap", "host", "Name the physics a model leaves out, from recordings."),
    "conceal": Command(
        "s2r_conceal.cli:conceal", "host,sim", "Recordings with hidden physics, to prove what a tool finds."
    ),
    "bench": Command(
        "s2r_protocol.cli.bench:bench", "host,sim", "Measure executor or planner on this machine."
    ),
    "stop": Command("s2r_host.cli_stop:stop", "", "Stop the arm on its path, from any terminal."),
    "state": Command(
        "s2r_host.cli_drives:state", "", "Tell the executor's state and why the arm does not move."
    ),
    "reset": Command("s2r_host.cli_drives:reset", "", "Clear a latched fault whose cause is gone."),
    "arm": Command("s2r_host.cli_drives:arm", "", "Switch the drives on; the arm holds its position."),
    "disarm": Command("s2r_host.cli_drives:disarm", "", "Close the brakes and switch the drives off."),
    "config": Command(
        "s2r_executor.cli_config:config", "", "Show the executor's configuration, or its schema."
    ),
    "completion": Command(
        "s2r_protocol.cli.completion:completion", "", "Print the completion script of a shell."
    ),
}
