"""Arbitration, bit time and injected faults."""

import pytest

from s2r_protocol.can.frames import CanFrame
from s2r_protocol.can.timing import BitRate
from s2r_protocol.exits import UsageError
from s2r_sim.bus.wire import QUEUE_FRAMES, Injection, Wire

TICK_NS = 1_000_000


def classic(can_id, length=8):
    return CanFrame(can_id, bytes(length)).pack()


def wire(*injections):
    return Wire(TICK_NS, BitRate(), [Injection.parse(text) for text in injections])


def drain(w, end_ns):
    frames = []
    while (frame := w.next(end_ns)) is not None:
        frames.append(frame)
    return frames


def test_lowest_identifier_wins():
    w = wire()
    for can_id in (0x300, 0x080, 0x181):
        w.offer(classic(can_id), None, 0, 0)
    assert [f.can_id for f in drain(w, TICK_NS)] == [0x080, 0x181, 0x300]


def test_a_frame_under_way_is_not_interrupted():
    w = wire()
    w.offer(classic(0x300), None, 0, 0)
    w.offer(classic(0x080), None, 1_000, 0)
    assert [f.can_id for f in drain(w, TICK_NS)] == [0x300, 0x080]
    assert w.free_ns == 270_000


def test_frames_that_do_not_fit_wait_for_the_next_window():
    w = wire()
    for can_id in range(0x100, 0x110):
        w.offer(classic(can_id), None, 0, 0)
    assert len(drain(w, TICK_NS)) == 7  # 7 x 135 µs
    w.close_tick(TICK_NS)
    assert w.load == pytest.approx(0.945)
    assert len(drain(w, 2 * TICK_NS)) == 7


def test_dropped_frame_takes_wire_time_but_reaches_nobody():
    w = wire("drop:0x181@5")
    w.offer(classic(0x181), None, 0, 5)
    assert drain(w, TICK_NS) == []
    assert w.free_ns == 135_000
    w.offer(classic(0x181), None, w.free_ns, 6)
    assert len(drain(w, TICK_NS)) == 1


def test_corrupted_frame_differs_in_one_payload_bit():
    w = wire("corrupt:*@0-9")
    sent = classic(0x181)
    w.offer(sent, None, 0, 3)
    (got,) = drain(w, TICK_NS)
    difference = [a ^ b for a, b in zip(sent, got.packet, strict=True)]
    assert sum(bin(d).count("1") for d in difference) == 1
    assert difference[:8] == [0] * 8


def test_delayed_frame_comes_one_tick_later():
    w = wire("delay:0x181@0")
    w.offer(classic(0x181), None, 0, 0)
    assert drain(w, TICK_NS) == []
    assert len(drain(w, 2 * TICK_NS)) == 1


def test_full_transmit_queue_is_told_to_the_sender():
    w = wire("enobufs:0x181@0")
    w.offer(classic(0x181), "me", 0, 0)
    assert drain(w, TICK_NS) == []
    assert w.free_ns == 0
    assert [f.sender for f in w.refused] == ["me"]


def test_what_babbles_fills_its_own_queue_and_no_memory():
    w, babbler, other = wire(), object(), object()
    for _ in range(1000):
        w.offer(classic(0x001), babbler, 0, 0)
    assert [f.sender for f in w.refused] == [babbler] * (1000 - QUEUE_FRAMES)
    w.offer(classic(0x100), other, 0, 0)
    sent = drain(w, 1000 * TICK_NS)
    assert [f.sender for f in sent] == [babbler] * QUEUE_FRAMES + [other]
    w.refused.clear()
    w.offer(classic(0x001), babbler, w.free_ns, 0)
    assert not w.refused


def test_answers_that_get_no_room_on_the_bus_do_not_pile_up():
    w = wire()
    for _ in range(1000):
        for node in (1, 2):
            w.offer(classic(0x180 + node), None, 0, 0)
    assert len(drain(w, 1000 * TICK_NS)) == 2 * QUEUE_FRAMES


@pytest.mark.parametrize("text", ["lose:0x181@1", "drop:181", "drop:0x181@", "drop:0xZZ@1", ""])
def test_malformed_rule_is_refused_with_the_form(text):
    with pytest.raises(UsageError, match="ACTION:ID@FIRST"):
        Injection.parse(text)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("delay:0x183@5-2", "the last tick, 2, is before the first, 5"),
        ("drop:0x99999@1", "no frame has the identifier 0x99999; they have 11 bits"),
        ("drop:0x800@1", "0x000 to 0x7ff"),
    ],
)
def test_a_rule_that_no_frame_can_meet_is_refused(text, reason):
    with pytest.raises(UsageError, match=reason):
        Injection.parse(text)


def test_a_rule_is_written_as_it_is_read_and_counts_what_it_has_met():
    w = wire("drop:0x181@0-9", "delay:*@3")
    for tick in (0, 3, 12):
        w.offer(classic(0x181), None, 0, tick)
        w.offer(classic(0x182), None, 0, tick)
    assert {str(rule): count for rule, count in w.disturbed.items()} == {"drop:0x181@0-9": 2, "delay:*@3": 1}


def test_rule_without_a_range_hits_one_tick():
    assert Injection.parse("drop:0x80@7") == Injection("drop", 0x80, 7, 7)
    assert Injection.parse("delay:*@7-9") == Injection("delay", None, 7, 9)


@pytest.mark.parametrize("ready_ns", [0, 200_000])
def test_answers_that_pass_at_once_take_the_time_of_answers_offered_one_by_one(ready_ns):
    packets = [classic(0x181 + k) for k in range(5)]
    offered, passed = wire(), wire()
    offered.free_ns = passed.free_ns = 40_000
    for packet in packets:
        offered.offer(packet, None, ready_ns, 0)
    ends = []
    while offered.next(TICK_NS) is not None:
        ends.append(offered.free_ns)
    assert passed.pass_all(packets, ready_ns, TICK_NS) == ends
    assert passed.free_ns == offered.free_ns
    for w in (offered, passed):
        w.close_tick(TICK_NS)
    assert passed.load == offered.load


def test_answers_do_not_pass_at_once_where_another_frame_or_an_injection_has_a_say():
    packets = [classic(0x181)]
    busy = wire()
    busy.offer(classic(0x080), None, 0, 0)
    for w, what in ((busy, packets), (wire("drop:0x181@5"), packets), (wire(), packets * 8)):
        before = w.free_ns
        assert w.pass_all(what, 0, TICK_NS) is None
        assert w.free_ns == before
