"""What the doctor says of an arm's limits is what the core takes; the executor says it before the core does."""

import numpy as np
import pytest
import yaml

from s2r_executor.config import load_config
from s2r_executor.core_process import CoreProcess, core_settings
from s2r_protocol.arms import bus_range as module
from s2r_protocol.arms import load_arm
from s2r_protocol.exits import UsageError

native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")


@pytest.mark.parametrize(
    ("field", "edge", "outwards"),
    [(field, edge, sign) for field, low, high, _ in module._RANGES for edge, sign in ((low, -1), (high, 1))
     if (field, sign) not in (("q_min", 1), ("q_max", -1))],
)  # fmt: skip
@pytest.mark.parametrize("packing", ["fd", "classic"])
def test_the_core_takes_each_limit_up_to_the_same_edge(arm, field, edge, outwards, packing):
    config = load_config(overrides={"bus": "unix:none", "packing": packing})
    settings = core_settings(config, arm)
    settings[field][2] = edge
    native.Shared.create(settings)
    settings[field][2] = float(np.nextafter(edge, outwards * np.inf))
    with pytest.raises(ValueError, match=field):
        native.Shared.create(settings)


def test_the_executor_refuses_all_of_them_at_once_with_joint_unit_and_degrees(tmp_path):
    raw = yaml.safe_load((load_arm("xmate3pro").directory / "arm.yaml").read_text())
    for joint in raw["joints"][:2]:
        joint["dq_max"] = 180.0
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(raw))
    with pytest.raises(UsageError) as refused:
        CoreProcess(load_config(overrides={"bus": "unix:none"}), load_arm(tmp_path))
    text = str(refused.value)
    assert "joint 'joint1' (index 0): dq_max = 180 rad/s is outside" in text
    assert "joint 'joint2' (index 1): dq_max = 180 rad/s is outside" in text
    assert "degrees? 180°/s are 3.142 rad/s" in text
