"""The ring that is written when a fault latches."""

from __future__ import annotations

import numpy as np
import pytest

from s2r_executor.black_box import BlackBox
from s2r_executor.core import EventKind
from s2r_protocol.faults import Cause

RECORD = np.dtype([("tick", "<u8"), ("q_ref", "<f8", 7)])
EVENT = np.dtype([("tick", "<u8"), ("kind", "<u2"), ("cause", "<u2")])


def records(first, count):
    out = np.zeros(count, RECORD)
    out["tick"] = np.arange(first, first + count)
    return out


def latch(tick, kind=EventKind.LATCH):
    return np.array([(tick, kind, Cause.DRIVE_FAULT)], EVENT)


def test_a_latch_writes_the_last_seconds_and_all_events(tmp_path):
    box = BlackBox(tmp_path, seconds=0.1, tick_ns=1_000_000)
    for first in range(0, 260, 13):
        box.add(records(first, 13), latch(first, EventKind.STATE))
    box.add(records(260, 5), latch(264))
    box.close()
    with np.load(tmp_path / "blackbox-264-DRIVE_FAULT.npz") as content:
        np.testing.assert_array_equal(content["records"]["tick"], np.arange(165, 265))
        assert len(content["events"]) == 21
        assert content["events"]["kind"][-1] == EventKind.LATCH


def test_a_batch_larger_than_the_ring_keeps_its_newest_records(tmp_path):
    box = BlackBox(tmp_path, seconds=0.01, tick_ns=1_000_000)
    box.add(records(0, 4), np.empty(0, EVENT))
    box.add(records(4, 37), latch(40))
    box.close()
    with np.load(tmp_path / "blackbox-40-DRIVE_FAULT.npz") as content:
        np.testing.assert_array_equal(content["records"]["tick"], np.arange(31, 41))


@pytest.mark.parametrize("batch", [1, 7, 255, 256, 257, 1000])
def test_batches_of_any_size_leave_the_last_seconds_whole(tmp_path, batch):
    box = BlackBox(tmp_path, seconds=0.6, tick_ns=1_000_000)
    for first in range(0, 2000, batch):
        box.add(records(first, batch), np.empty(0, EVENT))
    last = -(-2000 // batch) * batch
    box.add(records(last, 1), latch(last))
    box.close()
    with np.load(tmp_path / f"blackbox-{last}-DRIVE_FAULT.npz") as content:
        np.testing.assert_array_equal(content["records"]["tick"], np.arange(last - 599, last + 1))


def test_nothing_is_written_without_a_latch(tmp_path):
    box = BlackBox(tmp_path, seconds=0.01, tick_ns=1_000_000)
    box.add(records(0, 40), latch(3, EventKind.STOP_BEGUN))
    box.close()
    assert list(tmp_path.iterdir()) == []


def test_a_disk_that_refuses_is_logged_and_stops_nothing(tmp_path, caplog):
    box = BlackBox(tmp_path / "gone", seconds=0.01, tick_ns=1_000_000)
    box.add(records(0, 5), latch(4))
    box.close()
    assert "could not be written" in caplog.text
