"""A knob with spokes: its outline and its turn by colours, how it is pushed, and the joint and model that follow."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import mujoco
import numpy as np
import pytest

from s2r_host.model.build import build_model
from s2r_host.model.covered import without_covered
from s2r_host.model.knob import around_knob
from s2r_host.model.points import ObservedObject
from s2r_host.motion.bars import as_bar
from s2r_host.motion.knob_proposals import KnobPushSettings, knob_proposals
from s2r_host.motion.lever_axes import UP
from s2r_host.motion.levers import find_levers
from s2r_host.motion.robot_mask import back_project
from s2r_host.motion.scene import Scene, observed_scene
from s2r_host.perception.affordance import Affordance
from s2r_host.perception.frames import DepthFrame
from s2r_host.perception.knob_joint import knob_joint
from s2r_host.perception.knob_outline import KnobOutline, fit_outline, on_its_foot, turned_outline
from s2r_host.perception.motion import JointMotion
from s2r_host.perception.object_cloud import ObjectCloud
from s2r_host.perception.synthetic import look_at
from s2r_host.perception.view import DepthView
from s2r_host.run.guess import Tried
from s2r_host.run.knob_watch import LEAST_TURN_RAD, KnobWatch
from s2r_host.run.lever_guesses import GuessSettings, lever_guesses

K = np.array([[600.0, 0.0, 320.0], [0.0, 600.0, 200.0], [0.0, 0.0, 1.0]])
SHAPE = (400, 640)
X_BASE_CAMERA = look_at(np.array([0.05, -0.45, 0.55]), np.array([0.6, 0.0, 0.03]))
DECK_M, TOP_M = 0.01, 0.045
BODY, BODY_RADIUS_M, BODY_TOP_M = np.array([0.62, 0.16]), 0.02, 0.14
TOP, SIDE, DECK = [170, 160, 175], [120, 112, 125], [110, 140, 120]


def knob(angle_rad: float = 0.4, spokes: int = 4, reach_m: float = 0.033) -> KnobOutline:
    """A cross handle."""
    return KnobOutline(np.array([0.6, 0.02, TOP_M]), 0.020, reach_m, 0.018, spokes, angle_rad, DECK_M)


def look(*knobs: KnobOutline, coloured: bool = True, noise_m: float = 0.0, body: bool = False) -> DepthFrame:
    """The knobs, 12 mm thick, from the camera's place; with ``body`` the column of a faucet beside them."""
    v, u = np.mgrid[: SHAPE[0], : SHAPE[1]]
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(SHAPE)], axis=-1)
    way, eye = rays @ X_BASE_CAMERA[:3, :3].T, X_BASE_CAMERA[:3, 3]

    def at(height_m: float, part: tuple[slice, ...] = ()) -> tuple[np.ndarray, np.ndarray]:
        there = way[part]
        depth = (height_m - eye[2]) / there[..., 2]
        return depth, eye[:2] + depth[..., None] * there[..., :2]

    def part_around(p: np.ndarray, reach_m: float, *heights_m: float) -> tuple[slice, ...]:
        """Rows and columns of the picture outside of which nothing so near to p is seen between the heights."""
        near = np.any([np.linalg.norm(at(h)[1] - p, axis=-1) < reach_m + 0.005 for h in heights_m], axis=0)
        seen_at = (np.flatnonzero(near.any(axis=k)) for k in (1, 0))
        return tuple(slice(i[0], i[-1] + 1) if len(i) else slice(0) for i in seen_at)

    depth, _ = at(DECK_M)
    colour = np.broadcast_to(np.array(DECK, np.uint8), (*SHAPE, 3)).copy()
    for one in knobs:
        part = part_around(one.p_axis[:2], max(one.reach_m, one.hub_m) + one.width_m, TOP_M - 0.012, TOP_M)
        for height in np.linspace(TOP_M - 0.012, TOP_M, 25):
            z, xy = at(height, part)
            hit = one.inside_m(xy) > 0.0
            depth[part][hit], colour[part][hit] = z[hit], TOP if height == TOP_M else SIDE
    part = part_around(BODY, BODY_RADIUS_M, DECK_M, BODY_TOP_M) if body else ()
    for height in np.linspace(DECK_M, BODY_TOP_M, 80) if body else ():
        z, xy = at(height, part)
        hit = np.linalg.norm(xy - BODY, axis=-1) < BODY_RADIUS_M
        depth[part][hit], colour[part][hit] = z[hit], SIDE
    if noise_m:
        depth = depth + np.random.default_rng(0).normal(0.0, noise_m, SHAPE)
    return DepthFrame(depth.astype(np.float32), K, X_BASE_CAMERA, colour if coloured else None)


ABOUT = np.array([0.004, -0.003, -0.002])  # by which depth has the middle wrong


def fitted(true: KnobOutline, **options: bool) -> KnobOutline | None:
    return fit_outline(look(true, **options), true.p_axis + ABOUT, true.reach_m + 0.003, DECK_M)


@pytest.mark.parametrize("spokes", [2, 3, 4])
@pytest.mark.parametrize("angle", [0.1, 0.7])
def test_hub_and_spokes_are_told_to_a_millimetre(spokes: int, angle: float) -> None:
    true = knob(angle, spokes, 0.038)
    found = fitted(true)
    assert found is not None
    assert found.spokes == spokes
    assert np.linalg.norm(found.p_axis[:2] - true.p_axis[:2]) < 0.0015
    assert found.p_axis[2] == pytest.approx(true.p_axis[2], abs=0.002)
    assert found.reach_m == pytest.approx(true.reach_m, abs=0.0015)
    assert found.hub_m == pytest.approx(true.hub_m, abs=0.002)
    assert found.width_m == pytest.approx(true.width_m, abs=0.002)
    off = (found.angle - true.angle + 0.5 * true.pitch) % true.pitch - 0.5 * true.pitch
    assert abs(off) < np.radians(1.0)


def test_without_colour_and_without_spokes_there_is_no_outline() -> None:
    assert fitted(knob(), coloured=False) is None
    disc = replace(knob(), hub_m=0.033, reach_m=0.0335)
    found = fitted(disc)
    assert found is None or found.reach_m - found.hub_m < 0.006


def test_a_disc_is_no_knob_with_wide_spokes() -> None:
    """The top of a low column: five spokes as wide as they are long fill a circle, and were pushed at in vain."""
    disc = KnobOutline(knob().p_axis, 0.025, 0.026, 0.028, 5, 0.4, DECK_M)
    assert disc.valley_m > 0.9 * disc.reach_m
    assert fit_outline(look(disc, noise_m=0.0003), disc.p_axis, 0.026, DECK_M) is None
    assert knob().valley_m == pytest.approx(0.020)
    assert knob(spokes=2).valley_m == pytest.approx(0.020)


@pytest.mark.parametrize("turn", [-35.0, -12.0, 3.0, 20.0, 40.0])
def test_a_turn_is_told_to_half_a_degree(turn: float) -> None:
    before = knob()
    after = replace(before, angle=before.angle + np.radians(turn))
    found = fitted(before)
    assert found is not None
    turned = turned_outline(found, look(after))
    assert turned is not None
    assert np.degrees(turned.angle - found.angle) == pytest.approx(turn, abs=0.5)


def test_a_larger_turn_is_told_where_it_is_expected() -> None:
    before = knob()
    turned = turned_outline(
        before, look(replace(before, angle=before.angle + np.radians(70.0))), np.radians(55.0)
    )
    assert turned is not None
    assert np.degrees(turned.angle - before.angle) == pytest.approx(70.0, abs=0.5)


def test_a_knob_that_is_gone_is_not_found_again() -> None:
    elsewhere = replace(knob(), p_axis=knob().p_axis + np.array([0.0, 0.1, 0.0]))
    assert turned_outline(knob(), look(elsewhere)) is None


@pytest.mark.parametrize("turn", [-25.0, 25.0])
def test_the_joint_turns_about_the_knobs_own_axis_and_its_model_has_the_spokes(
    turn: float, tmp_path: Path
) -> None:
    before = knob()
    after = replace(before, angle=before.angle + np.radians(turn))
    views = [DepthView(look(one, noise_m=0.0005)) for one in (before, after)]
    joint = knob_joint(*views, before, after)
    assert joint.delta == pytest.approx(np.radians(abs(turn)))
    assert joint.axis_direction @ [0.0, 0.0, 1.0] == np.sign(turn)
    assert joint.intervals90.delta[0] < joint.delta < joint.intervals90.delta[1]
    built = build_model(joint, tmp_path)
    model = mujoco.MjModel.from_xml_path(str(built.mjcf_path))
    names = {model.geom(k).name for k in range(model.ngeom)}
    assert {f"part_spoke{k}" for k in range(4)} | {"part_hub"} <= names
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    spoke = model.geom("part_spoke0").id
    at = data.geom_xpos[spoke] - before.p_axis
    assert np.arctan2(at[1], at[0]) == pytest.approx(before.angle, abs=1e-3)


def test_a_knob_that_has_not_turned_has_an_axis_and_an_interval_all_the_same() -> None:
    before = knob()
    joint = knob_joint(DepthView(look(before)), DepthView(look(before)), before, before)
    assert np.linalg.norm(joint.axis_direction) == 1.0
    assert joint.intervals90.delta[0] < 0.0 < joint.intervals90.delta[1]


def test_what_smeared_depth_has_between_the_spokes_is_not_of_the_base() -> None:
    outline, up = knob(), np.array([0.0, 0.0, 1.0])
    notch = outline.angle + 0.5 * outline.pitch
    out = np.array([np.cos(notch), np.sin(notch), 0.0])
    rest = np.array([outline.p_axis + 0.028 * out - 0.01 * up, outline.p_axis + 0.06 * out - 0.01 * up])
    rest = np.vstack([rest, np.append((outline.p_axis + 0.028 * out)[:2], DECK_M)])
    nothing = np.empty((0, 3))
    seen = ObservedObject(nothing, nothing, rest, np.tile(up, (3, 1)), up, 0.0, None)
    left = without_covered(seen, around_knob(outline), JointMotion("revolute", outline.p_axis, up, 0.3))
    np.testing.assert_allclose(left.rest, rest[1:])


def test_noise_a_little_above_the_deck_beside_a_knob_is_not_of_the_base_but_the_deck_is() -> None:
    outline, up = knob(), np.array([0.0, 0.0, 1.0])
    beside = outline.p_axis + np.array([outline.reach_m + 0.02, 0.0, 0.0])
    rest = np.array(
        [[*beside[:2], DECK_M + 0.007], [*beside[:2], DECK_M + 0.001], [*beside[:2], DECK_M + 0.03]]
    )
    nothing = np.empty((0, 3))
    seen = ObservedObject(nothing, nothing, rest, np.tile(up, (3, 1)), up, 0.0, None)
    left = without_covered(seen, around_knob(outline), JointMotion("revolute", outline.p_axis, up, 0.3))
    np.testing.assert_allclose(left.rest, rest[1:])


def test_a_knob_stands_on_what_most_points_beside_it_lie_on() -> None:
    """The grid that finds decks has 6 mm cells: a foot 8 mm too high left the knob's sides in the base."""
    outline = replace(knob(), foot_m=DECK_M + 0.008)
    frame = look(knob(), noise_m=0.001)
    p = back_project(frame)[frame.depth_m > 0.0].reshape(-1, 3)
    assert on_its_foot(outline, p).foot_m == pytest.approx(DECK_M, abs=0.001)
    assert on_its_foot(outline, p[:50]).foot_m == outline.foot_m


def undecided(scene: Scene) -> Affordance:
    """A network that believes the same of every point."""
    p = scene.p_base[::4]
    cloud = ObjectCloud(
        p, np.zeros_like(p), np.zeros(len(p), np.int64), p.mean(axis=0), np.zeros((len(p), 1), np.float32)
    )
    belief = np.full(len(p), 0.5)
    return Affordance(cloud, belief, belief, np.tile(np.full(3, 3**-0.5), (len(p), 1)), ())


def bar(angle_rad: float = 0.4, hub_m: float = 0.018) -> KnobOutline:
    """Two spokes on a hub, which beside them is to be seen if it is wider than 8 mm."""
    return replace(knob(angle_rad, 2, 0.042), hub_m=hub_m, width_m=0.016)


def seen(name: str, degrees: float, of: Callable[[float], KnobOutline] = knob) -> Any:
    """A look at the knob turned so far."""
    frame = look(of(0.4 + np.radians(degrees)), noise_m=0.0003, body=True)
    mask = np.zeros(frame.depth_m.shape, bool)
    scene = observed_scene(frame, mask, None)
    return SimpleNamespace(name=name, capture=SimpleNamespace(frame=frame), arm_mask=mask, scene=scene)


def test_the_fingertip_passes_the_hub_and_overlaps_the_spoke() -> None:
    outline, settings = knob(), KnobPushSettings()
    pushes = list(knob_proposals(outline))
    assert len(pushes) > 50
    for push in pushes:
        out = push.p_contact - outline.p_axis
        radial = np.array([out[0], out[1], 0.0]) - (out @ push.direction) * push.direction
        half = settings.tip.ahead_m(push.X_base_tool[:3, :3], radial / np.linalg.norm(radial))
        assert abs(push.direction[2]) < 1e-9
        assert np.linalg.norm(radial) - half >= outline.hub_m + settings.beside_m - 1e-3
        assert np.linalg.norm(radial) - half <= outline.reach_m - settings.overlap_m + 1e-3
        assert push.p_contact[2] > outline.foot_m
    senses = {float(np.sign(np.cross(p.p_contact - outline.p_axis, p.direction)[2])) for p in pushes[:8]}
    assert senses == {1.0, -1.0}


def test_turns_add_up_over_the_looks_beyond_half_the_spacing() -> None:
    watch = KnobWatch(seen("A", 0.0))
    assert len(watch.now) == 1
    assert watch.joint() is None
    watch.look(seen("B", np.degrees(0.5 * LEAST_TURN_RAD)))
    assert watch.joint() is None
    for name, degrees in (("B2", -30.0), ("B3", -65.0)):
        watch.look(seen(name, degrees))
    joint = watch.joint()
    assert joint is not None
    assert joint.knob is not None
    assert np.degrees(joint.delta) == pytest.approx(65.0, abs=1.0)
    assert joint.axis_direction[2] == -1.0
    assert np.linalg.norm(joint.axis_origin_m[:2] - knob().p_axis[:2]) < 0.002


def test_a_knob_that_the_newest_look_does_not_show_tells_no_joint() -> None:
    """It would be said to stand in that look where it stood in the one before, and the push may have turned it on."""
    watch = KnobWatch(seen("A", 0.0))
    watch.look(seen("B", 20.0))
    assert watch.joint() is not None
    hidden = seen("B2", 45.0)
    noise = np.random.default_rng(0).integers(80, 100, hidden.capture.frame.colour.shape, dtype=np.uint8)
    hidden.capture.frame = replace(hidden.capture.frame, colour=noise)
    watch.look(hidden)
    assert watch.joint() is None
    watch.look(seen("B3", 45.0))
    joint = watch.joint()
    assert joint is not None
    assert np.degrees(joint.delta) == pytest.approx(45.0, abs=1.0)


def test_held_out_one_way_a_knob_is_turned_the_other_way_next() -> None:
    view, outline = seen("A", 0.0), knob()
    found = undecided(view.scene)
    first = lever_guesses(view.scene, found, GuessSettings(), (), [outline])[0]
    assert first.turns
    push = next(first.proposals)
    sense = np.cross(push.p_contact - outline.p_axis, push.direction)[2]
    tried = Tried(push.p_contact, push.direction, held_out=True, moved=False)
    again = lever_guesses(view.scene, found, GuessSettings(), [tried], [outline])[0]
    other = next(again.proposals)
    assert np.cross(other.p_contact - outline.p_axis, other.direction)[2] * sense < 0.0
    later = list(again.proposals)  # in the end that way as well, by another spoke
    assert any(np.cross(p.p_contact - outline.p_axis, p.direction)[2] * sense > 0.0 for p in later)


def test_a_bar_on_a_hub_is_followed_like_a_knob_and_a_straight_lever_is_not() -> None:
    watch = KnobWatch(seen("A", 0.0, bar))
    assert [one.spokes for one in watch.now] == [2]
    watch.look(seen("B", 25.0, bar))
    joint = watch.joint()
    assert joint is not None
    assert np.degrees(joint.delta) == pytest.approx(25.0, abs=1.0)
    assert np.linalg.norm(joint.axis_origin_m[:2] - bar().p_axis[:2]) < 0.002
    assert not KnobWatch(seen("A", 0.0, lambda angle: bar(angle, hub_m=0.008))).now


def test_a_level_piece_as_long_as_a_bar_is_guessed_to_turn_about_its_middle() -> None:
    view = seen("A", 0.0, bar)
    guesses = lever_guesses(view.scene, undecided(view.scene), GuessSettings())
    middle = bar().p_axis
    about = [one for one in guesses if np.linalg.norm(one.p.mean(axis=0)[:2] - middle[:2]) < 0.02]
    best = about[0]
    assert best.turns
    assert best.p_axis is not None
    assert np.linalg.norm(best.p_axis[:2] - middle[:2]) < 0.005
    push = next(best.proposals)
    arm = push.p_contact - best.p_axis
    assert 0.02 < np.linalg.norm(np.cross(push.direction, arm)) < 0.04
    # It may turn about an end all the same.
    assert any(guess.p_held is not None and not guess.turns for guess in about[1:])


def test_what_rises_or_is_long_or_stands_on_the_body_is_no_bar() -> None:
    lever = find_levers(seen("A", 0.0, bar).scene)[0]
    assert as_bar(lever) is not None
    along = lever.p_tip - lever.p_root
    assert as_bar(replace(lever, p_tip=lever.p_tip + 0.15 * np.linalg.norm(along) * UP)) is None
    assert as_bar(replace(lever, p_tip=lever.p_tip + along)) is None
    assert as_bar(replace(lever, rooted=False)) is None
