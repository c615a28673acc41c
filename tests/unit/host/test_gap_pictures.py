"""The report's pictures show what they say: the map that betrays an effect, the loops, the poses."""

import base64
import io
import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from s2r_host.gap.config import GapConfig
from s2r_host.gap.effects import catalogue
from s2r_host.gap.motion.model import RigidModel
from s2r_host.gap.motion.quantities import Quantity, since_turn
from s2r_host.gap.output.drawing import png
from s2r_host.gap.output.effect_maps import effect_figure, effect_map
from s2r_host.gap.output.figures import figure_joints, figures, maps_figure
from s2r_host.gap.output.link_shapes import visible_model
from s2r_host.gap.output.overlays import overlay_figure
from s2r_host.gap.output.poses import Moment, Stage, exaggeration, moments, poses_figure
from s2r_host.gap.pipeline import Analysis, analyse
from s2r_host.gap.rig import Drive, Secret, write_case

RIPPLE = 0.12  # N·m, 23 periods per turn
SHAPES = {
    "cogging": {"order": 23.0, "rub": 0.0},
    "motor_coupling": {"other": 0.0, "mutual": 0.0},
    "joint_play": {"racked": 1.0},
    "backlash": {"loose": 0.5, "reach": 0.1},
    "thermal_drift": {"T": 3.0, "target": 2.0},
}


@pytest.fixture(scope="module")
def analysis(tmp_path_factory) -> Analysis:
    """A pendulum whose motor cogs, with a second run and a held-out recording; few effects, as names are not asked."""
    secret, drive = Secret(extra={"cogging": RIPPLE}), Drive(duration_s=4.0)
    made = write_case(tmp_path_factory.mktemp("rig"), secret, drive)
    others = tuple(sorted(set(catalogue()) - {"cogging", "stribeck"}))
    config = GapConfig(skip=others, baselines=False, next_experiment=False)
    return analyse(made["model"], [made["fit"]], [made["holdout"]], [made["repeat"]], config, lambda _: None)


@pytest.mark.parametrize("name", sorted(catalogue()))
def test_every_effect_says_over_what_it_shows(analysis, name):
    session = analysis.fit[0]
    shape = SHAPES.get(name, {})
    quantity = catalogue()[name].shown_over(shape)
    assert isinstance(quantity, Quantity)
    x = quantity.along(analysis.model, session, 0, shape)
    assert x.shape == session.t.shape
    assert np.all(np.isfinite(x))
    assert "{" not in quantity.label(analysis.model, 0, shape)


def test_an_effect_that_says_nothing_shows_over_the_speed():
    from s2r_host.gap.effects.base import Effect
    from s2r_host.gap.motion.quantities import SPEED

    assert Effect().shown_over({}) is SPEED


def test_what_turns_with_the_shape_of_an_effect_is_drawn_over_something_else():
    def label(name, shape):
        model: Any = SimpleNamespace(joints=["a"], unit=lambda _: "m", effort_unit=lambda _: "N")
        return catalogue()[name].shown_over(shape).label(model, 0, shape)

    assert label("joint_play", {"racked": 0.0}) == "force across the joint [N]"
    assert label("joint_play", {"racked": 1.0}) == "moment of the pull beside the centre [N·m]"
    assert label("load_dependent_friction", {"load": 1.0}) == "size of the weight at rest [N]"
    assert label("backlash", {"w": 0.1}).startswith("effort in the transmission")
    assert label("backlash", {"loose": 0.1}) == "way since the last reversal [m]"
    assert not catalogue()["cogging"].shown_over({"order": 3.0, "rub": 0.0}).turned
    assert catalogue()["cogging"].shown_over({"order": 3.0, "rub": 1.0}).turned


def test_the_way_since_a_reversal_begins_anew_at_each():
    t = np.arange(0.0, 4.0, 0.01)
    q = 0.5 * np.sin(2.0 * np.pi * t / 2.0 + 0.5 * np.pi)  # turns at 0, 1, 2, 3 s
    v = np.gradient(q, t)
    session: Any = SimpleNamespace(t=t, q=q[:, None], v=v[:, None], v_eps=np.array([1e-3]))
    way = since_turn(session, 0)
    assert way[t == 0.99][0] == pytest.approx(-1.0, abs=1e-3)
    assert way[np.isclose(t, 1.0)][0] == pytest.approx(0.0, abs=1e-3)
    assert way[np.isclose(t, 1.99)][0] == pytest.approx(1.0, abs=1e-3)
    assert np.all(np.sign(way[1:98]) == -1.0)


def test_the_map_of_a_ripple_is_a_sine_within_its_period_and_nothing_is_left_of_it(analysis):
    assert [e.name for e in analysis.decision.effects] == ["cogging"]
    found = effect_map(analysis, analysis.decision.effects[0])
    assert found is not None
    assert found.label == "position within one period, as an angle [rad]"
    assert 0.0 <= found.x.min() < found.x.max() <= 2.0 * np.pi
    sine = np.linalg.lstsq(np.stack([np.sin(found.x), np.cos(found.x)], 1), found.before, rcond=None)[0]
    assert np.hypot(*sine) == pytest.approx(RIPPLE, rel=0.15)
    assert np.std(found.after) < 0.3 * np.std(found.before)
    assert found.alone is not None
    assert np.corrcoef(found.alone, found.effect)[0, 1] > 0.95


def labels(figure):
    return [t for axes in figure.axes if axes.axison for t in (axes.get_xlabel(), axes.get_ylabel()) if t]


def test_maps_have_units_and_cover_load_acceleration_and_time(analysis):
    general = labels(maps_figure(analysis, 0))
    for words in (
        "speed [rad/s]",
        "position [rad]",
        "acceleration [rad/s²]",
        "load that the model needs [N·m]",
    ):
        assert words in general
    assert "time, recordings one after another [s]" in general
    found = effect_map(analysis, analysis.decision.effects[0])
    assert found is not None
    assert all(x.endswith("]") for x in [*general, *labels(effect_figure(analysis, found))])


def test_held_out_motion_is_shown_in_both_loops(analysis):
    figure = overlay_figure(analysis, 0)
    told = labels(figure)
    for words in ("closed loop [rad]", "open loop [rad]", "effort residual [N·m]"):
        assert words in told
    error = next(axes for axes in figure.axes if axes.get_ylabel() == "its error [rad]")
    trace = next(t for t in analysis.before.traces if t.closed and t.held)
    rows = slice(trace.start, trace.start + len(trace.q))
    drawn = np.asarray(error.lines[0].get_ydata(), float)
    assert drawn == pytest.approx(trace.q[:, 0] - trace.session.q[rows, 0])
    assert error.lines[0].get_xdata() == pytest.approx(trace.session.t[rows])


def test_every_joint_with_a_named_effect_is_drawn():
    names = [f"j{i}" for i in range(5)]
    model = SimpleNamespace(joints=names, index=names.index)
    problem = SimpleNamespace(joints=list(range(5)))
    effects = [SimpleNamespace(joint=x) for x in ("j4", "j1", "j4", "j2")]
    places = [SimpleNamespace(joint=x) for x in ("j0", "j1", "j3")]
    a: Any = SimpleNamespace(
        model=model, problem=problem, places=places, decision=SimpleNamespace(effects=effects)
    )
    assert figure_joints(a) == [4, 1, 2]
    a.decision = SimpleNamespace(effects=[])
    assert figure_joints(a) == [0, 1]


def test_the_page_holds_the_map_and_the_poses(analysis):
    page = figures(analysis)
    assert "<h2>What betrays cogging on elbow</h2>" in page
    assert "<h2>Twin beside recording</h2>" in page
    pictures = re.findall(r"base64,([^']*)'", page)
    assert len(pictures) == 5
    assert all(imread(io.BytesIO(base64.b64decode(x))).std() > 0.01 for x in pictures)


def test_poses_say_how_far_off_the_twin_is_and_are_exaggerated_until_it_shows(analysis):
    shown, closed = moments(analysis)
    assert closed
    assert len(shown) == 3
    assert [m.t for m in shown] == sorted(m.t for m in shown)
    made = poses_figure(analysis)
    assert made is not None
    figure, told = made
    factor = int(re.search(r"drawn (\d+) times", told).group(1))  # pyright: ignore[reportOptionalMemberAccess]
    off = max(float(abs(m.before - m.recorded)[0]) for m in shown)
    assert 0.005 < factor * off < 1.0
    titles = [axes.get_title() for axes in figure.axes]
    m = shown[0]
    assert titles[0] == f"recorded: holdout, t = {m.t:.2f} s"
    assert titles[1].startswith(f"twin before: off by {1e3 * abs(m.before - m.recorded)[0]:.3g} mrad, ")
    assert titles[1].endswith(" mm")
    assert len(png(figure)) < 225_000  # a third more inside the page


def test_poses_that_differ_visibly_are_drawn_as_they_are(analysis):
    still = np.zeros(1)
    stage = Stage(analysis, np.array([still]))
    for off, factors in ((0.5, {1}), (0.0, {1}), (1e-4, set(range(200, 3000)))):
        assert exaggeration(stage, [Moment("r", 0.0, still, still + off, still)]) in factors


def test_a_slide_that_ran_away_is_drawn_nearer(tmp_path):
    path = tmp_path / "slide.xml"
    path.write_text(BARE.format(bodies=SLIDE))
    rigid: Any = SimpleNamespace(model=RigidModel(path))
    still = np.zeros(1)
    shown = [Moment("r", float(q), still + q, still + 50.0, still + q) for q in (0.0, 0.1)]
    factor = exaggeration(Stage(rigid, np.array([m.recorded for m in shown])), shown)
    assert 0.05 < 50.0 * factor < 0.5


BARE = """<mujoco><worldbody>{bodies}</worldbody></mujoco>"""
SLIDE = """<body name="b"><joint name="x" type="slide" axis="1 0 0"/>
<inertial mass="1" pos="0 0 0" diaginertia="1 1 1"/></body>"""
ROTOR = SLIDE.replace('type="slide"', 'type="hinge"')
LINKS = """<body name="b"><joint name="x" axis="0 1 0"/><inertial mass="1" pos="0 0 .1" diaginertia="1 1 1"/>
<body name="c" pos="0 0 .4"><joint name="y" axis="0 1 0"/><inertial mass="1" pos="0 0 .1" diaginertia="1 1 1"/>
<geom type="box" size=".05 .05 .1" group="{group}"/></body></body>"""


@pytest.mark.parametrize(
    ("bodies", "more"), [(SLIDE, 2), (ROTOR, 3), (LINKS.format(group=0), 2), (LINKS.format(group=4), 2)]
)
def test_bodies_without_a_shape_are_drawn_as_rods_and_blocks(tmp_path, bodies, more):
    """A model whose only shapes are for contacts shows those."""
    path = tmp_path / "bare.xml"
    path.write_text(BARE.format(bodies=bodies))
    rigid = RigidModel(path)
    poses = np.linspace(0.0, 0.3, 3)[:, None] * np.ones(len(rigid.joints))
    model = visible_model(rigid, poses)
    assert model.ngeom - rigid.model.ngeom == more
    assert set(model.geom_bodyid[model.geom_group == 0]) >= {1}
    assert np.all(model.geom_group == 0)
    assert model.body_mass == pytest.approx(rigid.model.body_mass)
