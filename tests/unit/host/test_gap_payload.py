"""A load that was found weighs as much in the patched model as it was said to, and in its file, too."""

from types import SimpleNamespace

import mujoco
import numpy as np
import pytest

from s2r_host.gap.effects.payload import EFFECT

ARM = """<mujoco><worldbody><body name="link"><joint name="joint" axis="0 1 0"/>
  <geom size="0.05" pos="0.3 0 0"/></body></worldbody></mujoco>"""


def _held(model):
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return float(data.qfrc_bias[0])


def test_a_patched_load_hangs_at_its_place_in_memory_and_in_the_file():
    bare, spec = mujoco.MjModel.from_xml_string(ARM), mujoco.MjSpec.from_string(ARM)
    context = SimpleNamespace(model=SimpleNamespace(body_name=lambda body: "link", model=bare))
    assert EFFECT.patch(context, spec, 0, {"body": 1, "reach": 1.0}, np.array([2.0]))  # pyright: ignore[reportArgumentType]
    loaded = spec.compile()
    weight = -2.0 * 9.81 * 0.3
    assert _held(loaded) - _held(bare) == pytest.approx(weight, rel=1e-6)
    assert _held(mujoco.MjModel.from_xml_string(spec.to_xml())) - _held(bare) == pytest.approx(
        weight, rel=1e-4
    )


def test_a_load_beside_that_of_an_earlier_patch_has_a_name_of_its_own():
    bare, spec = mujoco.MjModel.from_xml_string(ARM), mujoco.MjSpec.from_string(ARM)
    context = SimpleNamespace(model=SimpleNamespace(body_name=lambda body: "link", model=bare))
    for _ in range(2):
        assert EFFECT.patch(context, spec, 0, {"body": 1, "reach": 1.0}, np.array([2.0]))  # pyright: ignore[reportArgumentType]
    assert _held(spec.compile()) - _held(bare) == pytest.approx(-4.0 * 9.81 * 0.3, rel=1e-6)
