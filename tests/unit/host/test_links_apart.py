"""Links of the arm keep the distance that the executor wants between them, from the start pose to the delivery."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from s2r_host.motion.links_apart import LinksApart
from s2r_host.planning import PlanRequest, PlanSettings, plan_manipulation
from s2r_host.planning.free_space import FreeSpace
from s2r_host.planning.planner import scene_of
from s2r_host.planning.sample_objects import DrawerShape, drawer_mjcf
from s2r_host.planning.scene import Scene
from s2r_host.planning.task import PlanRefusedError
from s2r_host.trajectory import deliver
from s2r_host.trajectory.deliver import MotionHitsError
from s2r_host.trajectory.retreat import retreat
from s2r_protocol.arms import ArmDescription, load_arm
from s2r_protocol.arms.clearance import LINKS_APART_M
from s2r_protocol.arms.link_pairs import link_pairs

ARM = load_arm("xmate3pro")
SIX = Path(__file__).parent / "six_joint_arm"
FOLDED = np.array([0.0, -1.5, 0.0, 2.07, 0.0, 2.07, 0.0])


def least_distance(arm: ArmDescription) -> Callable[[np.ndarray], float]:
    """Of any two links, at a posture [m], as a ruler has it."""
    model, shapes, _ = link_pairs(arm)
    data, found = model.createData(), shapes.createData()

    def measured(q: np.ndarray) -> float:
        pin.computeDistances(model, data, shapes, found, q)
        return min(result.min_distance for result in found.distanceResults)

    return measured


@pytest.fixture(scope="module")
def drawer(tmp_path_factory):
    path = tmp_path_factory.mktemp("drawer") / "object.xml"
    path.write_text(drawer_mjcf(DrawerShape()))
    return path


def request_of(drawer: Path, q: np.ndarray) -> PlanRequest:
    return PlanRequest(ARM, drawer, 0.0, 0.08, q, settings=PlanSettings(threads=1))


def with_links_near(scene: Scene) -> Scene:
    """The scene for an arm whose links are said to come too near on any motion of more than one posture."""
    said: Any = SimpleNamespace(
        near=lambda q: "two links come nearer than 10 mm: a against b" if len(q) > 1 else None
    )
    scene = replace(scene)
    scene.__dict__["links"] = said
    return scene


def test_a_motion_on_which_two_links_come_too_near_is_told():
    links = LinksApart(ARM)
    way = np.linspace(ARM.q_home, FOLDED, 50)
    assert links.near(way[:5]) is None
    said = links.near(way)
    assert said is not None
    assert said.startswith("two links come nearer than 10 mm: ")


def test_so_it_is_where_only_the_last_posture_has_them_too_near():
    distance = least_distance(ARM)
    way = np.linspace(ARM.q_home, FOLDED, 4000)
    first = next(k for k, q in enumerate(way) if distance(q) < LINKS_APART_M)
    links = LinksApart(ARM)
    assert links.near(way[: first - 20]) is None
    assert links.near(way[: first + 1]) is not None
    assert links.near(way[first : first + 1]) is not None


@pytest.mark.parametrize("arm", [ARM, load_arm(SIX)], ids=lambda arm: arm.name)
def test_free_space_leaves_what_the_executor_wants_between_links(drawer, arm):
    scene = scene_of(replace(request_of(drawer, arm.q_home), arm=arm))
    rng, measured = np.random.default_rng(1), least_distance(arm)
    q = np.concatenate(
        [
            rng.uniform(arm.limits.q_min, arm.limits.q_max, (300, arm.dof)),
            rng.normal(arm.q_home, 0.5, (300, arm.dof)),
        ]
    )
    apart_m = np.array([measured(row) for row in q])
    touches = FreeSpace(scene, 1).touches(q, 0.0)
    near = apart_m < 0.99 * LINKS_APART_M
    assert (near & (apart_m > 0.0)).any()
    assert touches[near].all()
    # What is far from everything else is free where links are just so far apart.
    aside = [row for row, d in zip(q, apart_m, strict=True) if 1.01 * LINKS_APART_M < d < 0.05]
    assert not FreeSpace(scene, 1).touches(np.array(aside), 0.0).all()


def test_a_start_pose_with_links_too_near_is_refused(drawer):
    distance, rng = least_distance(ARM), np.random.default_rng(0)
    spread = 0.5 * np.array([0.3, 1, 1, 1, 1, 1, 1])
    low, high = ARM.limits.q_min + 0.1, ARM.limits.q_max - 0.1
    drawn = (np.clip(ARM.q_home + rng.normal(0.0, spread), low, high) for _ in range(10_000))
    q = next(q for q in drawn if 0.002 < distance(q) < 0.008)
    with pytest.raises(
        PlanRefusedError, match=r"at the start pose two links come nearer than 10 mm: .* against"
    ):
        plan_manipulation(request_of(drawer, q))


def test_a_motion_on_which_links_come_too_near_is_neither_delivered_nor_a_way_out(drawer):
    request = request_of(drawer, ARM.q_home)
    scene = scene_of(request)
    result = plan_manipulation(request, scene)
    delivered = deliver(request, result, scene=scene, perturbations=())
    near = with_links_near(scene)
    with pytest.raises(MotionHitsError, match="on the way two links come nearer than 10 mm"):
        deliver(request, result, scene=near, perturbations=())
    with pytest.raises(PlanRefusedError, match="on the way out two links come nearer than 10 mm"):
        retreat(delivered.trajectory, request, near)
