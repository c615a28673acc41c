"""The process that plans for ``s2r plan``: an order on standard input, what it does and its answer on standard output.

Every line it writes is one JSON object: ``doing`` and ``control_steps`` on the way, then ``answer`` with what
``plan.json`` holds, or ``refused`` with the reason and the exit code, or ``bug``. Whatever else prints goes to standard
error. See ``s2r_host.plan_process`` for the other side.
"""

from __future__ import annotations

import json
import logging
import os
import sys
import traceback
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from s2r_host.plan_process import PlanOrder
from s2r_protocol.exits import S2RError, UsageError

if TYPE_CHECKING:
    import numpy as np

_MEMBERS = 3  # of an ensemble whose size nobody told
_MOST_MEMBERS = 99


def main() -> None:
    """Carry out the order that is on standard input."""
    channel = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    order = PlanOrder(**json.load(sys.stdin))
    logging.getLogger("toppra").setLevel(logging.ERROR)

    def tell(doing: str, control_steps: int) -> None:
        print(json.dumps({"doing": doing, "control_steps": control_steps}), file=channel, flush=True)

    try:
        last = carried_out(order, tell)
    except BrokenPipeError:
        return  # nobody listens any more
    except Exception as error:  # noqa: BLE001 - the other side has to be told, whatever it is
        traceback.print_exc()
        last = {"bug": f"{type(error).__name__}: {error}"}
    print(json.dumps(last), file=channel, flush=True)


def carried_out(order: PlanOrder, tell: Callable[[str, int], None]) -> dict[str, Any]:
    """The last line: an answer or a refusal. ``tell`` hears what is done and how many control steps were."""
    try:
        return {"answer": _planned(order, tell)}
    except S2RError as error:
        return {"refused": str(error), "exit_code": int(error.exit_code)}


def _planned(order: PlanOrder, tell: Callable[[str, int], None]) -> dict[str, Any]:
    from s2r_host.planning.patience import Patience
    from s2r_host.planning.settings import PlanSettings
    from s2r_host.planning.tools import tool_named, write_arm_with_tool
    from s2r_host.trajectory.plan_scene import PlanTask, plan_scene
    from s2r_protocol.arms import load_arm

    out = Path(order.out)
    description = load_arm(order.arm)
    if order.tool is not None:
        description = write_arm_with_tool(description, tool_named(order.tool), out / "arm")
    members, doubt_files = ensemble(order.ensemble)
    task = PlanTask(
        scene=Path(order.scene),
        joint=order.joint,
        s_target=order.target,
        target_type=order.target_type,
        arm=description,
        out=out,
        q_initial=posture(order.q0, description.joint_names),
        seed=order.seed,
        settings=PlanSettings(threads=order.threads, ensemble=members),
        doubt_files=doubt_files,
    )
    patience = Patience(order.time_limit_s, lambda doing: tell(doing, patience.control_steps))
    return plan_scene(task, patience)


def ensemble(values: tuple[str, ...]) -> tuple[int, tuple[Path, ...]]:
    """Number of members and files with intervals that ``--ensemble`` was given.

    Raises:
        UsageError: Several numbers, or one out of range.
    """
    numbers = [int(value) for value in values if value.isdecimal()]
    files = tuple(Path(value) for value in values if not value.isdecimal())
    if len(numbers) > 1:
        raise UsageError(
            f"--ensemble was given {len(numbers)} numbers of members; give one, and files besides"
        )
    members = numbers[0] if numbers else (_MEMBERS if files else 1)
    if not 1 <= members <= _MOST_MEMBERS or members % 2 == 0:
        raise UsageError(
            f"--ensemble {members} is not allowed: an odd number up to {_MOST_MEMBERS}, the believed object and "
            "opposite pairs of others"
        )
    return members, files


def posture(text: str | None, joint_names: tuple[str, ...]) -> np.ndarray | None:
    """The start pose that ``--q0`` was given, (dof,) [rad], or None.

    Raises:
        UsageError: Not numbers, or not one for each joint.
    """
    import numpy as np

    if text is None:
        return None
    try:
        values = [float(part) for part in text.replace(" ", "").split(",")]
    except ValueError as error:
        raise UsageError(f"--q0 {text!r}: expected comma-separated numbers [rad]") from error
    if len(values) != len(joint_names):
        raise UsageError(
            f"--q0 has {len(values)} numbers; the arm needs {len(joint_names)}: {', '.join(joint_names)}"
        )
    return np.array(values)


if __name__ == "__main__":
    main()
