"""The sealed truth beside what the host said, in the values that the demo's target is counted in."""

import json

import pytest

from s2r_sim.demo.verdict import open_truth
from s2r_sim.score import true_joint

TARGET, PUSHED, ENDED = 0.5, -0.4, 0.48  # as the target is counted: from as found


@pytest.fixture(params=[1.0, -1.0], ids=["as the truth", "the other way round"])
def folder(request, world, tmp_path):
    """A run whose host came to count its joint from where the push had left the part."""
    way = request.param
    world.save(tmp_path / "world.json")
    rows = ["t_s,master_tick,object,joint1,contact_part,contact_base,contact_table,part_force_N"]
    found = 0.8
    states = [found + way * s for s in (0.0, PUSHED, PUSHED, 0.6, ENDED)]
    rows += [f"{k},{1000 * k},{s},0.1,0,0,0,0" for k, s in enumerate(states)]
    (tmp_path / "truth.csv").write_text("\n".join(rows) + "\n")
    attempts = [{"number": 1, "tick_start": 2000}, {"number": 2, "tick_start": 3000}]
    run = {
        "exit": {"code": 0, "reason": "there"},
        "s_origin": -PUSHED,
        "s_target": TARGET - PUSHED,
        "delta": 0.01,
        "joint": {"axis_direction": (way * true_joint(world)[1]).tolist()},
        "goals": [{"s_target": TARGET - PUSHED, "attempts": [1, 2]}],
        "attempts": attempts,
        "wall_s": 1.0,
    }
    (tmp_path / "run").mkdir()
    (tmp_path / "run/run.json").write_text(json.dumps(run))
    return tmp_path


def test_a_joint_that_counts_from_a_later_view_is_judged_from_as_found(folder, world):
    verdict = open_truth(3, folder, world.commitment)
    assert verdict.s_target == pytest.approx(TARGET)
    assert verdict.s_true == pytest.approx(ENDED)
    assert verdict.delta_true == pytest.approx(TARGET - ENDED)
    assert verdict.delta_first_true == pytest.approx(TARGET - 0.6)
    assert verdict.delta_r_true == pytest.approx((TARGET - ENDED) / (TARGET - PUSHED))
    assert verdict.deltas_true == pytest.approx((TARGET - ENDED,))
    assert verdict.commitment_holds


def test_figures_of_a_last_target_that_no_motion_was_made_for_are_not_those_of_the_one_before(folder, world):
    """The part was there already, or no plan was found."""
    path = folder / "run/run.json"
    run = json.loads(path.read_text())
    path.write_text(json.dumps(run | {"s_target": ENDED - PUSHED + 0.002}))
    verdict = open_truth(3, folder, world.commitment)
    assert verdict.delta_true == pytest.approx(0.002)
    assert verdict.deltas_true == pytest.approx((TARGET - ENDED,))
    assert verdict.delta_first_true is None
    assert verdict.delta_r_true is None
