"""The Zenoh key space."""

import pytest

from s2r_protocol.keys import ArmKeys


def test_keys_of_one_arm_share_its_prefix():
    keys = ArmKeys("cell1", "left")
    assert keys.plan == "cell1/left/plan"
    assert keys.capture("wrist") == "cell1/left/camera/wrist/capture"


@pytest.mark.parametrize("name", ["", "a/b", "a*", "x$y", "q?", "h#", "two words"])
def test_names_with_a_meaning_to_zenoh_are_refused(name):
    with pytest.raises(ValueError, match="cell name"):
        ArmKeys(cell=name)
    with pytest.raises(ValueError, match="arm name"):
        ArmKeys(arm=name)
