"""The front end's side of the shared memory: configuration, shapes, the committed stub."""

from __future__ import annotations

import mmap
import time

import numpy as np
import pytest

from s2r_executor.admission import SPLICE_ACCELERATION_RAD_S2, SPLICE_POSITION_RAD, SPLICE_VELOCITY_RAD_S
from s2r_executor.config import AdmissionConfig, CoreConfig, ExecutorConfig
from s2r_executor.core_process import core_settings
from s2r_protocol.arms import load_arm

_native = pytest.importorskip("s2r_executor._native", reason="the native core is not built")

CONFIG = {
    "dof": 2,
    "tick_ns": 1_000_000,
    "packing": "fd",
    "bus": "unix:/nowhere.sock",
    "clock": "real",
    "q_min": [-1.0, -1.0],
    "q_max": [1.0, 1.0],
    "dq_max": [1.0, 1.0],
    "ddq_max": [5.0, 5.0],
    "dddq_max": [100.0, 100.0],
    "tau_max": [10.0, 10.0],
}


@pytest.mark.parametrize("name", list(CONFIG))
def test_missing_field_is_named(name):
    config = {key: value for key, value in CONFIG.items() if key != name}
    with pytest.raises(ValueError, match=f"config: field '{name}' is missing"):
        _native.Shared.create(config)


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"speed": 1}, "config: unknown field 'speed'"),
        ({"dof": 8}, r"dof = 8 is outside \[1, 7\]"),
        ({"dof": 0}, r"dof = 0 is outside \[1, 7\]"),
        ({"dof": "two"}, "dof = 'two' has the wrong type"),
        ({"tick_ns": 0}, "tick_ns = 0 is outside"),
        ({"packing": "xl"}, "packing = 'xl': expected 'fd' or 'classic'"),
        ({"clock": "sundial"}, "clock = 'sundial': expected 'real' or 'lockstep'"),
        ({"bus": "tcp:1"}, "bus = 'tcp:1': expected unix:PATH or can:INTERFACE"),
        ({"bus": "unix:"}, "expected unix:PATH"),
        ({"bus": "unix:" + 300 * "x"}, "too long"),
        ({"q_min": [-1.0]}, "'q_min' has 1 values, expected dof = 2"),
        ({"q_min": [-1.0, 1.0]}, r"q_min\[1\] = 1 is not below q_max\[1\] = 1"),
        ({"q_max": [1.0, 9.0]}, r"q_max\[1\] = 9 is outside"),
        ({"dq_max": [1.0, float("nan")]}, r"dq_max\[1\] = nan is outside"),
        ({"dq_max": [1.0, 7.0]}, r"dq_max\[1\] = 7 is outside"),
        ({"ddq_max": [0.0, 1.0]}, r"ddq_max\[0\] = 0 is outside"),
        ({"gate_margin": 0.9}, "gate_margin = 0.9 is outside"),
        ({"gate_margin": float("nan")}, "gate_margin = nan is outside"),
        ({"path_tolerance_rad": 0.0}, "path_tolerance_rad = 0 is outside"),
        ({"feedback_stop_ticks": 12}, r"feedback_fault_ticks = 10 is outside \[12"),
        ({"drive_extrapolation_ticks": 4}, "drive_extrapolation_ticks = 4 is outside"),
        ({"record_capacity": 1}, "record_capacity = 1 is outside"),
        ({"tick_ns": 250_000}, "bus load = .* limit 0.7; use a longer tick_ns or the other packing"),
        ({"packing": "classic", "tick_ns": 500_000}, "bus load = "),
    ],
)
def test_bad_field_is_refused_by_name(changes, text):
    with pytest.raises(ValueError, match=text):
        _native.Shared.create({**CONFIG, **changes})


def test_fresh_block_has_no_core():
    snapshot = _native.Shared.create(CONFIG).snapshot()
    assert not snapshot.alive
    assert snapshot.state == 0


def test_running_core_shows_that_it_lives():
    shared = _native.Shared.create(CONFIG)
    core = _native.Core(shared)
    core.step([], 0)
    assert shared.snapshot().alive
    del core
    assert not shared.snapshot().alive


def test_a_core_killed_in_the_middle_of_a_write_leaves_the_last_whole_snapshot():
    shared = _native.Shared.create(CONFIG)
    core = _native.Core(shared)
    with mmap.mmap(shared.fd, 0) as memory:
        seen = []
        for tick in range(4):
            core.step([], tick)
            seen.append(np.frombuffer(memory[:], np.int64))
        # The sequence lock counts two per write, odd while one is under way; it lies before what it guards.
        at = 8 * int(np.flatnonzero((np.diff(seen, axis=0) == 2).all(axis=0))[0])
        core.step([], 4)
        whole = shared.snapshot()
        memory[at : at + 8] = (int.from_bytes(memory[at : at + 8], "little") + 1).to_bytes(8, "little")
        left = shared.snapshot()
        assert (left.tick, left.alive) == (whole.tick, True)
        time.sleep(1.1)
        assert not shared.snapshot().alive


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"t": np.zeros(1), "stop_duration": np.zeros(0)}, "1 knots, allowed 2..4096"),
        ({"t": np.zeros(4097)}, "4097 knots"),
        ({"q": np.zeros((3, 3))}, r"q has shape \(3, 3\), expected \(3, 2\)"),
        ({"dq": np.zeros((2, 2))}, r"dq has shape \(2, 2\), expected \(3, 2\)"),
        ({"ddq": np.zeros((4, 2))}, r"ddq has shape \(4, 2\), expected \(3, 2\)"),
        ({"stop_duration": np.zeros(3)}, "3 values, expected one per segment, 2"),
    ],
)
def test_plan_of_the_wrong_shape_is_refused_by_name(changes, text):
    zeros = np.zeros((3, 2))
    arrays = {
        "t": np.arange(3.0),
        "q": zeros,
        "dq": zeros,
        "ddq": zeros,
        "stop_duration": np.ones(2),
        **changes,
    }
    with pytest.raises(ValueError, match=text):
        _native.Shared.create(CONFIG).submit_plan(1, 1, *arrays.values(), 0.0, 0.0)


def test_full_command_ring_says_so():
    shared = _native.Shared.create(CONFIG)
    taken = [shared.command(3, 0) for _ in range(65)]
    assert taken == [True] * 64 + [False]


def test_records_and_events_have_the_documented_fields():
    shared = _native.Shared.create(CONFIG)
    records, events = shared.records(), shared.events()
    assert set(records.dtype.names) == {
        "tick", "stamp_ns", "lateness_ns", "state", "cause", "plan_id", "plan_t", "speed_scale",
        "q_ref", "dq_ref", "ddq_ref", "q_meas", "dq_meas", "tau_meas",
    }  # fmt: skip
    assert records["q_ref"].shape == (0, 2)
    assert set(events.dtype.names) == {
        "tick", "stamp_ns", "kind", "state", "cause", "joint", "plan_id", "value", "limit",
    }  # fmt: skip


def test_records_and_events_can_be_saved_as_they_come(tmp_path):
    shared = _native.Shared.create(CONFIG)
    np.savez(tmp_path / "black-box.npz", records=shared.records(), events=shared.events())
    with np.load(tmp_path / "black-box.npz") as content:
        assert content["records"].dtype["q_ref"].shape == (2,)


def ends(model):
    """Every number of a section of the configuration at both ends of its range."""
    for name, field in model.model_fields.items():
        for bound in field.metadata:
            for side in ("ge", "gt", "le", "lt"):
                if (value := getattr(bound, side, None)) is not None:
                    yield name, value


ORDERED = (
    ("feedback_warn_ticks", "feedback_stop_ticks", "feedback_fault_ticks"),
    ("temperature_warn_C", "temperature_stop_C"),
)


@pytest.mark.parametrize(("name", "value"), ends(CoreConfig))
def test_what_the_configuration_takes_the_core_takes(name, value):
    together = next((names for names in ORDERED if name in names), (name,))
    config = CoreConfig(**dict.fromkeys(together, value))
    settings = core_settings(ExecutorConfig(core=config, bus="unix:/nowhere.sock"), load_arm("xmate3pro"))
    _native.Shared.create(settings)


@pytest.mark.parametrize("name", CoreConfig.model_fields)
def test_every_number_of_the_core_has_both_ends(name):
    if CoreConfig.model_fields[name].annotation in (int, float):
        assert len([1 for other, _ in ends(CoreConfig) if other == name]) == 2


def test_admission_and_core_hold_the_same_numbers():
    assert SPLICE_POSITION_RAD == _native.SPLICE_POSITION_RAD
    assert SPLICE_VELOCITY_RAD_S == _native.SPLICE_VELOCITY_RAD_S
    assert SPLICE_ACCELERATION_RAD_S2 == _native.SPLICE_ACCELERATION_RAD_S2
    assert AdmissionConfig().start_tolerance_rad == _native.START_TOLERANCE_RAD
    limits = dict(ends(AdmissionConfig))  # the last of each: the upper end where there are two
    assert limits["stop_duration_max_s"] == _native.MAX_STOP_S
    assert limits["max_duration_s"] == _native.MAX_DURATION_S
    assert limits["min_segment_s"] == _native.MIN_SEGMENT_S
    assert limits["max_knots"] == _native.MAX_KNOTS
