"""Sensors of a user's scene leave the planner's own where they are read after rollouts."""

from __future__ import annotations

from pathlib import Path

from s2r_host.planning.scene import Scene, build_scene
from s2r_host.planning.scene_spec import ROBOT_CONTACTS
from s2r_host.planning.settings import PlanSettings
from s2r_protocol.arms import load_arm

SCENE = Path(__file__).parents[2] / "bench" / "scenes" / "tap.xml"


def _scene(path: Path) -> Scene:
    return build_scene(load_arm("xmate3pro"), path, "lever", PlanSettings(threads=1), in_scene=True)


def test_the_planners_sensors_are_where_the_rollouts_read_them(tmp_path):
    path = tmp_path / "measured.xml"
    sensors = '<sensor><jointpos joint="lever"/><jointvel joint="lever"/></sensor>'
    path.write_text(SCENE.read_text().replace("</worldbody>", f"</worldbody>{sensors}"))
    plain, measured = _scene(SCENE), _scene(path)
    assert measured.coarse.nsensordata == plain.coarse.nsensordata
    assert measured.fine_contacts == plain.fine_contacts
    # Where host/native/scorer.cpp reads them: the tool's pose, then the robot's contacts.
    assert measured.coarse.sensor(ROBOT_CONTACTS).adr[0] == 7
