"""Recordings: read back by two independent readers, cut at the plan, complete and findable."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from s2r_executor.config import RecorderConfig
from s2r_executor.observations import Encoder, Timeline
from s2r_executor.recorder import PlanIdentity, Recorder
from s2r_executor.recorder_wire import Batch, batch_frame, batch_of, merged
from s2r_protocol.faults import ExecutorState
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.ros2.definitions import message_type

OFFSET_NS = 1_700_000_000_000_000_000
IDENTITY = PlanIdentity(plan_id=1, seq=7, epoch=2, sender="host:1", label="push")


@pytest.fixture
def recorder(tmp_path, arm):
    encoder = Encoder(arm, Timeline(OFFSET_NS, 1_000_000, stepped=True))
    recorder = Recorder(
        tmp_path, arm, "/lab/xmate3pro", encoder, RecorderConfig(chunk_bytes=16_384), {"model_hash": "ab"}
    )
    yield recorder
    recorder.close()


def feed(recorder, core):
    recorder.feed(core.records(100_000), core.events(), "host:1")


def wait_complete(recorder, seq):
    deadline = time.monotonic() + 300
    while not recorder.answer(seq).complete:
        assert time.monotonic() < deadline, recorder.answer(seq)
        assert not recorder.loss.ticks, recorder.loss
        time.sleep(0.01)
    return recorder.answer(seq).path


def run_plan(recorder, core, plan, identity=IDENTITY, ticks=2400):
    """Play a plan and feed the recorder; returns its first tick."""
    if core.state == ExecutorState.DISARMED:
        core.arm()
    core.advance(50)
    feed(recorder, core)
    begun = core.tick + 1
    recorder.open_plan(identity, b"as received")
    core.submit_plan(
        identity.plan_id,
        core.epoch,
        plan.t,
        plan.q,
        plan.dq,
        plan.ddq,
        np.full(len(plan.t) - 1, 0.4),
        0.05,
        0.02,
    )
    for _ in range(ticks // 100):
        core.advance(100)
        feed(recorder, core)
    return begun


def messages(path):
    with path.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        return [
            (channel.topic.rsplit("/", 1)[1], message.log_time, decoded)
            for _, channel, message, decoded in reader.iter_decoded_messages()
        ]


def test_a_plan_recording_holds_every_tick_of_the_plan_and_a_short_tail(recorder, core, smooth_plan):
    plan = smooth_plan()
    begun = run_plan(recorder, core, plan)
    path = wait_complete(recorder, 7)
    assert path.name == "plan-2-7.mcap"
    joint_states = [(t, m) for topic, t, m in messages(path) if topic == "joint_states"]
    (ended,) = (t for topic, t, m in messages(path) if topic == "events" and "PLAN_DONE" in m.msg)
    assert len(joint_states) == (ended - OFFSET_NS) // 1_000_000 - begun + 200  # that tick is already HOLD
    assert [t for t, _ in joint_states] == [
        OFFSET_NS + (begun + i) * 1_000_000 for i in range(len(joint_states))
    ]
    first, last = joint_states[0][1], joint_states[-1][1]
    assert list(first.name) == [f"joint{i}" for i in range(1, 8)]
    np.testing.assert_allclose(first.position, plan.q[0], atol=1e-3)
    np.testing.assert_allclose(last.position, plan.q[-1], atol=1e-3)
    assert len(last.effort) == 7


def test_answers_of_recordings_long_ago_are_forgotten(recorder, monkeypatch):
    monkeypatch.setattr("s2r_executor.recorder._KEPT_ANSWERS", 3)
    for seq in (7, 8, 9, 7, 10):
        recorder.open_plan(replace(IDENTITY, plan_id=seq, seq=seq), b"")
    assert list(recorder._state.answers) == [9, 7, 10]
    assert "no plan 8 is among the last 3" in recorder.answer(8).reason


def test_commands_are_the_reference_and_carry_no_effort(recorder, core, smooth_plan):
    plan = smooth_plan()
    run_plan(recorder, core, plan)
    commands = [m for topic, _, m in messages(wait_complete(recorder, 7)) if topic == "joint_commands"]
    np.testing.assert_allclose(commands[-1].position, plan.q[-1], atol=1e-12)
    assert len(commands[0].effort) == 0


def test_states_and_events_are_recorded_with_every_change(recorder, core, smooth_plan):
    run_plan(recorder, core, smooth_plan())
    found = messages(wait_complete(recorder, 7))
    states = [m.state for topic, _, m in found if topic == "executor_state"]
    assert states[0] == ExecutorState.RUN
    assert states[-1] == ExecutorState.HOLD
    texts = [m.msg for topic, _, m in found if topic == "events"]
    assert any("PLAN_STARTED" in text for text in texts)
    assert any("PLAN_DONE" in text for text in texts)


def test_a_stopped_plan_ends_its_recording(recorder, core, smooth_plan):
    run_plan(recorder, core, smooth_plan(), ticks=600)
    core.command(pb.STOP, core.epoch)
    core.advance()
    core.until(ExecutorState.HOLD)
    core.advance(300)
    feed(recorder, core)
    found = messages(wait_complete(recorder, 7))
    assert any("STOP_REQUESTED" in m.msg for topic, _, m in found if topic == "events")


def test_the_next_plan_ends_the_tail_of_the_one_before(recorder, core, smooth_plan):
    run_plan(recorder, core, smooth_plan(), ticks=2000)
    core.advance(60)
    feed(recorder, core)
    run_plan(recorder, core, smooth_plan(start=core.q), PlanIdentity(2, 9, 2, "host:1", "second"))
    first, second = wait_complete(recorder, 7), wait_complete(recorder, 9)
    last_of_first = max(t for _, t, _ in messages(first))
    first_of_second = min(t for _, t, _ in messages(second))
    assert last_of_first <= first_of_second  # the start event carries the tick before


def begin(recorder, core, plan, identity, **splice):
    """Announce a plan and hand it to the core; with ``parent_id`` and ``splice_t`` it waits for its moment."""
    recorder.open_plan(identity, b"as received")
    stops = np.full(len(plan.t) - 1, 0.4)
    arrays = (plan.t, plan.q, plan.dq, plan.ddq, stops)
    assert core.submit_plan(identity.plan_id, core.epoch, *arrays, 0.05, 0.02, **splice)


def play(recorder, core, ticks, step=50):
    for _ in range(ticks // step):
        core.advance(step)
        feed(recorder, core)


def ticks_of(path):
    return [round((t - OFFSET_NS) / 1e6) for topic, t, _ in messages(path) if topic == "joint_states"]


def test_a_plan_that_waits_for_its_splice_takes_nothing_from_the_recording_of_the_running_one(
    recorder, core, smooth_plan
):
    run_plan(recorder, core, smooth_plan(), ticks=500)
    back = smooth_plan(step=(-0.1,) * 7, start=smooth_plan().q[-1])
    begin(recorder, core, back, PlanIdentity(2, 9, 2, "host:1", "onward"), parent_id=1, splice_t=2.0)
    play(recorder, core, 4500)
    first, second = ticks_of(wait_complete(recorder, 7)), ticks_of(wait_complete(recorder, 9))
    assert len(first) == 2000 - 1  # the first tick of the second is the last of the first
    assert second[0] == first[-1] + 1
    assert [set(np.diff(t)) for t in (first, second)] == [{1}, {1}]


def test_a_file_that_somebody_removed_before_its_plan_was_refused_ends_no_recording(recorder, tmp_path):
    recorder.open_plan(IDENTITY, b"")
    deadline = time.monotonic() + 60
    while not (files := list(tmp_path.glob("plan-*.mcap"))):
        assert time.monotonic() < deadline
        time.sleep(0.01)
    files[0].unlink()
    recorder.drop_plan(1, "the core refused it")
    while not recorder.answer(7).reason:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    assert "never ran" in recorder.answer(7).reason
    recorder.close()
    assert recorder.loss.reason == ""
    assert list(tmp_path.glob("session-*.mcap")) == [recorder.session_path]  # no second one was begun


def test_a_splice_that_the_core_refuses_leaves_the_running_plan_its_recording(recorder, core, smooth_plan):
    run_plan(recorder, core, smooth_plan(), ticks=500)
    begin(recorder, core, smooth_plan(), PlanIdentity(2, 9, 2, "host:1", "off"), parent_id=1, splice_t=1.0)
    recorder.drop_plan(2, "the core refused it")
    play(recorder, core, 2500)
    ticks = ticks_of(wait_complete(recorder, 7))
    assert len(ticks) == 2000 + 200 - 1
    assert not recorder.answer(9).complete
    assert "never ran" in recorder.answer(9).reason


def test_a_waiting_plan_that_a_stop_or_a_newer_one_ends_has_no_recording(
    recorder, core, smooth_plan, tmp_path
):
    run_plan(recorder, core, smooth_plan(), ticks=500)
    back = smooth_plan(step=(-0.1,) * 7, start=smooth_plan().q[-1])
    for plan_id in (2, 3):
        identity = PlanIdentity(plan_id, 7 + plan_id, 2, "host:1", "onward")
        begin(recorder, core, back, identity, parent_id=1, splice_t=2.0)
        play(recorder, core, 100)
    core.command(pb.STOP, core.epoch)
    core.advance()
    core.until(ExecutorState.HOLD)
    play(recorder, core, 300)
    wait_complete(recorder, 7)
    last = PlanIdentity(4, 12, core.epoch, "host:1", "last")
    begin(recorder, core, smooth_plan(start=core.q), last)
    play(recorder, core, 2500)
    wait_complete(recorder, 12)
    for seq in (9, 10):
        assert (recorder.answer(seq).complete, recorder.answer(seq).reason) == (
            False,
            f"plan {seq} never ran",
        )
    assert len(list(tmp_path.glob("plan-*"))) == 2


def test_attachments_and_facts_are_in_the_file(recorder, core, smooth_plan, arm):
    run_plan(recorder, core, smooth_plan())
    with wait_complete(recorder, 7).open("rb") as stream:
        reader = make_reader(stream)
        attached = {a.name: a.data for a in reader.iter_attachments()}
        facts = {m.name: m.metadata for m in reader.iter_metadata()}
        header = reader.get_header()
    assert attached["plan.s2r"] == b"as received"
    assert attached["xmate3pro.urdf"].decode() == arm.urdf
    assert b"dddq_max" in attached["limits.yaml"]
    assert facts["s2r"]["model_hash"] == "ab"
    assert facts["s2r.plan"]["label"] == "push"
    assert header.profile == "ros2"


def test_rosbags_decodes_every_message_of_a_recording(recorder, core, smooth_plan):
    run_plan(recorder, core, smooth_plan())
    store = get_typestore(Stores.ROS2_JAZZY)
    name = "s2r_msgs/msg/ExecutorState"
    store.register(get_types_from_msg(message_type(name).text, name))
    seen = set()
    with wait_complete(recorder, 7).open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert channel.message_encoding == "cdr"
            assert schema.encoding == "ros2msg"
            store.deserialize_cdr(message.data, schema.name)
            seen.add(schema.name)
    assert seen == {"sensor_msgs/msg/JointState", name, "rcl_interfaces/msg/Log"}


def test_a_dropped_plan_leaves_no_file_and_no_answer(recorder, core, tmp_path):
    recorder.open_plan(IDENTITY, b"")
    recorder.drop_plan(1, "the core refused it")
    recorder.close()
    assert not list(tmp_path.glob("plan-*"))
    assert not recorder.answer(7).complete


def test_while_the_plan_runs_the_recording_is_incomplete_without_an_error(recorder, core, smooth_plan):
    run_plan(recorder, core, smooth_plan(), ticks=500)
    answer = recorder.answer(7)
    assert (answer.complete, answer.reason) == (False, "")


def test_an_unknown_plan_and_a_recorder_without_folder_say_why(recorder, arm):
    assert "no plan 3" in recorder.answer(3).reason
    nothing = Recorder(
        None, arm, "/x", Encoder(arm, Timeline(0, 1_000_000, stepped=True)), RecorderConfig(), {}
    )
    nothing.open_plan(IDENTITY, b"")
    assert "--record" in nothing.answer(7).reason
    nothing.close()


def test_a_recording_cut_off_by_a_crash_is_readable_up_to_the_last_half_second(
    recorder, core, smooth_plan, tmp_path
):
    run_plan(recorder, core, smooth_plan(), ticks=1900)
    deadline = time.monotonic() + 300
    growing, cut = tmp_path / "plan-2-7.mcap", tmp_path / "cut.mcap"
    while True:  # the writer opens the file in its own time and flushes at least every half second
        recorder.feed(core.records(), core.events(), "")
        if growing.exists() and growing.stat().st_size > 20_000:
            break
        assert time.monotonic() < deadline
        time.sleep(0.05)
    cut.write_bytes(growing.read_bytes())
    from mcap.exceptions import EndOfFile
    from mcap.stream_reader import StreamReader

    kinds = []
    try:
        with cut.open("rb") as stream:
            for record in StreamReader(stream).records:
                kinds.append(type(record).__name__)
    except EndOfFile:
        pass
    assert kinds.count("Message") + kinds.count("Chunk") > 1


def test_two_plans_with_the_same_numbers_get_two_files(recorder, core, smooth_plan, tmp_path):
    run_plan(recorder, core, smooth_plan())
    first = wait_complete(recorder, 7)
    core.advance(300)
    run_plan(recorder, core, smooth_plan(start=core.q), PlanIdentity(2, 7, 2, "host:2", "again"))
    second = wait_complete(recorder, 7)
    assert first != second
    assert second.name == "plan-2-7-2.mcap"


def test_session_file_runs_from_start_to_end_at_the_publishing_rate(recorder, core, smooth_plan):
    run_plan(recorder, core, smooth_plan())
    recorder.close()
    states = [t for topic, t, _ in messages(recorder.session_path) if topic == "joint_states"]
    assert len(states) == -(-core.tick // 10)
    assert set(np.diff(states)) == {10_000_000}


def test_arrays_with_fields_out_of_order_cross_to_the_writer_unchanged():
    layout = {"names": ["b", "a"], "formats": ["<u4", ("<f8", (3,))], "offsets": [24, 0], "itemsize": 32}
    records = np.zeros(5, np.dtype(layout))
    records["a"], records["b"] = np.arange(15).reshape(5, 3), np.arange(5)
    back = batch_of(batch_frame(Batch(records, np.empty(0), "host:1")))
    np.testing.assert_array_equal(back.records["a"], records["a"])
    np.testing.assert_array_equal(back.records["b"], records["b"])
    assert (len(back.events), back.holder) == (0, "host:1")


def test_merged_batches_hold_every_record_in_order():
    layout = np.dtype({"names": ["b", "a"], "formats": ["<u4", "<f8"], "offsets": [8, 0], "itemsize": 16})
    parts = []
    for begin in (0, 3, 3, 7):
        records = np.zeros(0 if begin == 3 else 3, layout)
        records["b"] = begin + np.arange(len(records))
        parts.append(batch_frame(Batch(records, np.empty(0), f"host:{begin}")))
    back = batch_of(merged(parts))
    assert back.records["b"].tolist() == [0, 1, 2, 7, 8, 9]
    assert back.holder == "host:7"
