"""What `s2r plan` and `s2r gap` leave goes through admission and is played by the stand-in, as recording and table."""

import json
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from s2r_host.gap.output.next_experiment import _write, motions
from s2r_host.trajectory import TimeLawSettings, time_law
from s2r_host.trajectory.plan_files import write_plan_csv, write_plan_mcap
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.root import main

ARM = load_arm("xmate3pro")


@pytest.mark.parametrize(("name", "loops"), [("plan.mcap", 1), ("plan.csv", 2)])
def test_a_planned_motion_is_replayed_on_the_stand_in(tmp_path, capsys, name, loops):
    """On another one each time: a replay that has moved an object may still hold it, and went off with it."""
    home = np.asarray(ARM.q_home)
    motion = time_law(home + 0.2 * np.linspace(0.0, 1.0, 5)[:, None], ARM, TimeLawSettings(speed=0.3))
    if name == "plan.csv":
        write_plan_csv(tmp_path / name, motion, ARM.joint_names)
    else:
        write_plan_mcap(tmp_path / name, motion, ARM, "away from home")
    with pytest.raises(SystemExit) as ended:
        main(
            ["replay", str(tmp_path / name), "--out", str(tmp_path / "again"), "--json", "--loop", str(loops)]
        )
    said = capsys.readouterr()
    assert ended.value.code == 0, said.err
    answer = json.loads(said.out)
    assert answer["against"] == "plan"
    assert max(answer["rms_rad"].values()) < 2e-3
    stand_ins = sorted(path.name for path in tmp_path.glob("again/stand-in*"))
    assert stand_ins == (["stand-in"] if loops == 1 else ["stand-in-1", "stand-in-2"])


def test_the_next_experiment_of_s2r_gap_is_played_by_the_executor(tmp_path, capsys):
    """As `s2r gap` leaves it in its folder: joint 2 moves, the others stay where the recordings had them."""
    seen: Any = SimpleNamespace(q=np.tile(ARM.q_home, (10, 1)))
    analysis: Any = SimpleNamespace(model=SimpleNamespace(joints=ARM.joint_names), fit=[seen])
    q = motions(ARM.q_home[1] - 0.1, ARM.q_home[1] + 0.1, 0.4, 1.0)["reversals of shrinking amplitude"]
    _write(tmp_path / "next_experiment.csv", analysis, 1, q)
    with pytest.raises(SystemExit) as ended:
        main(["replay", str(tmp_path / "next_experiment.mcap"), "--out", str(tmp_path / "again"), "--json"])
    said = capsys.readouterr()
    assert ended.value.code == 0, said.err
    answer = json.loads(said.out)
    assert max(answer["rms_rad"].values()) < 2e-3
