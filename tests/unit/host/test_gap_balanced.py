"""MuJoCo's ``balanceinertia`` may replace what a model states."""

import pytest

from s2r_host.gap.motion.model import RigidModel


def model(folder, moments, balance="true"):
    (folder / "door.xml").write_text(
        f'<mujoco><compiler balanceinertia="{balance}"/><worldbody><body name="door"><joint name="hinge" axis="0 0 1"/>'
        f'<inertial pos="0.4 0 0" mass="15" {moments}/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    return RigidModel(folder / "door.xml")


@pytest.mark.parametrize(
    "moments",
    ['diaginertia="4.616303 5.25631044 0.640007439"', 'fullinertia="4.616303 5.25631044 0.640007439 0 0 0"'],
)
def test_a_thin_plate_whose_numbers_are_rounded_is_told(tmp_path, moments):
    (note,) = model(tmp_path, moments).inertia_replaced()
    assert "'door', 0.64, 4.616, 5.256, by 3.504, 3.504, 3.504 kg·m²" in note


def test_inertia_that_stays_as_stated_is_no_news(tmp_path):
    assert not model(tmp_path, 'diaginertia="4.6163 5.2563 0.6401"').inertia_replaced()
    assert not model(tmp_path, 'diaginertia="4.6163 5.2563 0.6401"', balance="false").inertia_replaced()
