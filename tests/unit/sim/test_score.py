"""The truth log and what the scorer reads from it."""

import numpy as np
import pytest

from s2r_sim.errors import TruthFileError
from s2r_sim.plant import Plant
from s2r_sim.score import final_state, read_truth
from s2r_sim.truth import TruthLog


@pytest.fixture
def truth_file(tmp_path):
    rows = ["t_s,master_tick,object,joint1,joint2,contact_part,contact_base,contact_table,part_force_N"]
    for k, s in enumerate([0.080, 0.080, 0.045, 0.045, 0.045, 0.195, 0.231]):
        rows.append(f"{k * 0.01:.3f},{10 * k},{s},0.1,0.2,{int(k in (2, 5))},0,0,{3.5 * (k == 5)}")
    path = tmp_path / "truth.csv"
    path.write_text("\n".join(rows) + "\n0.07,70,0.2")
    return path


def test_values_are_relative_to_the_state_as_found(truth_file):
    state = final_state(truth_file, t_before_plan=0.04)
    assert state.as_found == 0.080
    assert state.before_plan == pytest.approx(-0.035)
    assert state.final == pytest.approx(0.151)
    assert state.delta(0.15) == pytest.approx(-0.001)
    assert state.delta_r(0.15) == pytest.approx(-0.001 / 0.185)


def test_moment_before_the_plan_may_be_a_tick(truth_file):
    assert final_state(truth_file, tick_before_plan=44).before_plan == pytest.approx(-0.035)
    assert final_state(truth_file).before_plan is None


def test_a_tick_of_one_of_several_executors_is_refused(truth_file):
    """A second one began to count again: its tick 10 is another time than the first one's."""
    text = truth_file.read_text().replace("0.050,50,", "0.050,0,").replace("0.060,60,", "0.060,10,")
    truth_file.write_text(text)
    truth = read_truth(truth_file)
    assert truth.s_at(0.06) == 0.231
    with pytest.raises(TruthFileError, match="several executors"):
        truth.s_at_tick(10)


def test_relative_error_without_a_start_is_refused(truth_file):
    with pytest.raises(ValueError, match="needs a start"):
        final_state(truth_file).delta_r(0.15)


def test_half_written_row_is_left_out(truth_file):
    truth = read_truth(truth_file)
    assert truth.t[-1] == 0.06
    assert truth.q.shape == (7, 2)
    assert truth.contact_part.tolist() == [False, False, True, False, False, True, False]


def test_a_last_number_that_was_cut_short_is_not_taken_for_a_whole_one(tmp_path):
    head = "t_s,master_tick,object,joint1,contact_part,contact_base,contact_table,part_force_N,other_0\n"
    path = tmp_path / "truth.csv"
    path.write_text(head + "0.000,0,0.08,0.1,0,0,0,0,0.0812\n0.010,10,0.08,0.1,0,0,0,0,0.0")
    assert read_truth(path).others.tolist() == [[0.0812]]


def test_a_row_that_is_no_numbers_is_told_as_damage(truth_file):
    truth_file.write_text(truth_file.read_text().replace("0.045", "0.0x5"))
    with pytest.raises(TruthFileError, match=r"truth\.csv is damaged: .*0\.0x5"):
        read_truth(truth_file)


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "t_s,master_tick,object\n", "t_s,master_tick,object\n0,0,0.1\n"]
)
def test_file_without_truth_is_refused(tmp_path, text):
    (tmp_path / "x.csv").write_text(text)
    with pytest.raises(TruthFileError, match=r"x\.csv"):
        read_truth(tmp_path / "x.csv")


def test_log_holds_a_row_per_10_ms_from_the_start(arm, world, tmp_path):
    plant = Plant(arm, world)
    log = TruthLog(tmp_path / "t.csv", plant)
    plant.observers.append(log)
    for _ in range(55):
        plant.advance(1_000_000)
    log.close()
    truth = read_truth(tmp_path / "t.csv")
    np.testing.assert_allclose(truth.t, np.arange(6) * 0.01)
    assert truth.s[0] == pytest.approx(world.object.opening_m)
    np.testing.assert_allclose(truth.q[0], arm.q_home, atol=1e-8)
    assert not truth.contact_part.any()


def test_unwritable_log_is_named(arm, world, tmp_path):
    with pytest.raises(TruthFileError, match="no/t"):
        TruthLog(tmp_path / "no" / "t.csv", Plant(arm, world))
