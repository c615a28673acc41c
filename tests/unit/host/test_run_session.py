"""Links of a run: closed however it goes, and honest about whether the arm is at rest."""

from __future__ import annotations

import errno
import json
import time
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from io import StringIO
from types import SimpleNamespace

import numpy as np
import pytest
from rich.console import Console

from s2r_host.errors import ArmStoppedError, PeerUnreachableError, RecordingError
from s2r_host.run import pipeline
from s2r_host.run import session as module
from s2r_host.run.journal import Journal
from s2r_host.run.record import RunRecord
from s2r_host.run.session import Session, open_session
from s2r_host.run.settings import RunSettings
from s2r_host.run.task import DRAWER
from s2r_protocol.exits import ExitCode
from s2r_protocol.faults import Cause, ExecutorState

AT_REST = SimpleNamespace(state=ExecutorState.HOLD, cause=Cause.STOP_REQUESTED, lease_holder="")
MOVING = SimpleNamespace(state=ExecutorState.STOPPING, cause=Cause.HOST_LOST, lease_holder="")
OWN = SimpleNamespace(state=ExecutorState.RUN, cause=Cause.NONE, lease_holder="link")
ANOTHERS = SimpleNamespace(state=ExecutorState.RUN, cause=Cause.NONE, lease_holder="host:9")


class Part:
    """A link or a recorder that notes when it is closed."""

    def __init__(self, name, closed, error=None, status=AT_REST):
        self.name, self.closed, self.error, self._status = name, closed, error, status
        self.identity = SimpleNamespace(software="test")

    def add_stage(self, name, phase, note=""):
        pass

    def close(self):
        self.closed.append(self.name)
        if self.error is not None:
            raise self.error

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()

    @contextmanager
    def leased(self):
        yield

    def arm_drives(self):
        pass

    def status(self):
        if isinstance(self._status, Exception):
            raise self._status
        return self._status


def session_of(tmp_path, closed, status=AT_REST, recorder_error=None):
    settings = RunSettings(task=DRAWER, target=0.1, out=tmp_path)
    parts = {name: Part(name, closed) for name in ("camera",)}
    return Session(
        settings, Journal(), None, Part("link", closed, status=status), parts["camera"],
        Part("recorder", closed, recorder_error), np.random.default_rng(0),
    )  # fmt: skip


def test_every_link_is_closed_although_the_recording_cannot_be_finished(tmp_path):
    closed = []
    with (
        pytest.raises(OSError, match="no space"),
        session_of(tmp_path, closed, recorder_error=OSError("no space")),
    ):
        pass
    assert closed == ["recorder", "link", "camera"]


@pytest.mark.parametrize("failing", ["RunRecorder", "CameraLink"])
def test_what_was_opened_is_closed_where_the_next_cannot_be(tmp_path, monkeypatch, failing):
    closed = []
    for name in ("ExecutorLink", "RunRecorder", "CameraLink"):
        monkeypatch.setattr(module, name, lambda *_, name=name, **__: Part(name, closed))

    def fail(*_, **__):
        raise OSError("no space")

    monkeypatch.setattr(module, failing, fail)
    with pytest.raises(OSError, match="no space"):
        open_session(RunSettings(task=DRAWER, target=0.1, out=tmp_path), Journal())
    assert closed == (["ExecutorLink"] if failing == "RunRecorder" else ["RunRecorder", "ExecutorLink"])


def interrupt(sent):
    raise KeyboardInterrupt


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (AT_REST, "the arm is at rest (HOLD, STOP_REQUESTED)"),
        (MOVING, "the arm still moves (STOPPING, HOST_LOST): look at it"),
        (OWN, "the arm still moves (RUN, NONE): look at it"),
        (ANOTHERS, "the arm moves for 'host:9', another host, which holds the lease (RUN, NONE)"),
        (PeerUnreachableError("silence"), "that the arm is at rest was not confirmed: look at it"),
        (KeyboardInterrupt(), "that the arm is at rest was not confirmed: look at it"),
    ],
    ids=["at rest", "moving", "own motion", "another's motion", "silent", "interrupted twice"],
)
def test_an_interrupted_move_tells_what_the_executor_confirmed(tmp_path, status, said):
    if isinstance(status, KeyboardInterrupt):
        session = session_of(tmp_path, [])
        session.link.status = lambda: interrupt([])
    else:
        session = session_of(tmp_path, [], status)
    with pytest.raises(KeyboardInterrupt):
        session.play(interrupt)
    assert session.rest == said


def test_a_move_that_went_through_ends_at_rest(tmp_path):
    session = session_of(tmp_path, [])
    session.play(lambda sent: None)
    assert session.rest == "the arm is at rest"


def test_a_dry_run_sends_nothing_whoever_asks_for_a_motion(tmp_path):
    session = session_of(tmp_path, [])
    session.settings = replace(session.settings, dry_run=True)
    asked = []
    with pytest.raises(RuntimeError, match="in a dry run; nothing was sent"):
        session.play(asked.append)
    assert not asked
    assert session.rest == "nothing was moved"


@pytest.mark.parametrize("dry_run", [True, False])
def test_a_latched_fault_ends_a_run_that_would_move_before_it_looks(tmp_path, monkeypatch, dry_run):
    latched = SimpleNamespace(
        state=ExecutorState.FAULT, why_not_moving="A fault is latched: ...; 's2r reset'."
    )
    session, begun = session_of(tmp_path, [], latched), []
    session.settings = replace(session.settings, dry_run=dry_run)
    monkeypatch.setattr(pipeline, "open_session", lambda *_: session)
    monkeypatch.setattr(pipeline, "_introduce", lambda record, session: None)
    monkeypatch.setattr(pipeline, "_loop", lambda *_: begun.append(1))
    monkeypatch.setattr(pipeline, "write_run_json", lambda record: None)
    monkeypatch.setattr(RunRecord, "arm_name", "arm", raising=False)
    record = pipeline.run_task(session.settings, Journal())
    assert bool(begun) == dry_run
    if not dry_run:
        assert record.code == ExitCode.REFUSED
        assert record.reason.startswith("the arm cannot move, the executor is FAULT: A fault is latched")


@pytest.mark.parametrize("connected", [True, False])
def test_an_interrupt_before_anything_moved_says_so(tmp_path, monkeypatch, connected):
    def loop(*_):
        raise KeyboardInterrupt

    def connect(settings, journal):
        if not connected:
            raise KeyboardInterrupt
        return session_of(tmp_path, [])

    monkeypatch.setattr(pipeline, "open_session", connect)
    monkeypatch.setattr(pipeline, "_introduce", lambda record, session: None)
    monkeypatch.setattr(pipeline, "_loop", loop)
    monkeypatch.setattr(pipeline, "write_run_json", lambda record: None)
    monkeypatch.setattr(RunRecord, "arm_name", "arm", raising=False)
    record = pipeline.run_task(RunSettings(task=DRAWER, target=0.1, out=tmp_path), Journal())
    assert record.code == ExitCode.INTERRUPTED
    assert record.reason == "interrupted by the operator; nothing was moved"


def test_what_is_written_before_a_target_is_asked_for_says_that_the_run_goes_on(tmp_path, monkeypatch):
    """Whoever looks on would take it for a run that ended with a bug."""
    session, told = session_of(tmp_path, []), []
    session.settings = RunSettings(task=DRAWER, target=None, out=tmp_path)

    def ask(record):
        told.append(json.loads((tmp_path / "run.json").read_text()))
        return 0.1

    monkeypatch.setattr(pipeline, "open_session", lambda *_: session)
    monkeypatch.setattr(pipeline, "planned_where_it_stands", nullcontext)
    for name in ("_introduce", "_home", "_believe", "_to_targets", "learn_from_push", "Feeling"):
        monkeypatch.setattr(pipeline, name, lambda *_: None)
    seen = SimpleNamespace(scene=SimpleNamespace(p_base=()))
    monkeypatch.setattr(pipeline, "observe", lambda *_: seen)
    monkeypatch.setattr(RunRecord, "add_view", lambda record, view: view)
    monkeypatch.setattr(pipeline, "push_until_told", lambda *_: SimpleNamespace(after=seen))
    record = pipeline.run_task(session.settings, Journal(), ask=ask)
    told.append(json.loads((tmp_path / "run.json").read_text()))
    assert [run["ended"] for run in told] == [False, True]
    assert record.ended
    assert [run["target_told"] for run in told] == [None, 0.1]


def test_a_disk_that_fills_up_during_a_run_is_no_bug_and_the_arms_rest_is_told(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(pipeline, "open_session", lambda *_: session_of(tmp_path, []))
    monkeypatch.setattr(pipeline, "_introduce", lambda record, session: None)
    monkeypatch.setattr(pipeline, "_loop", full)
    monkeypatch.setattr(pipeline, "write_run_json", full)
    monkeypatch.setattr(RunRecord, "arm_name", "arm", raising=False)
    record = pipeline.run_task(RunSettings(task=DRAWER, target=0.1, out=tmp_path), Journal())
    assert record.code == ExitCode.NOT_READY
    assert record.reason == (
        f"{tmp_path}: No space left on device; make room, or name another disk with --out; nothing was moved; "
        "no run.json is left: No space left on device"
    )


def no_room(*_):
    raise OSError(errno.ENOSPC, "No space left on device")


def test_a_stage_that_failed_ends_with_its_own_error_where_nobody_can_be_told():
    def staged(journal, *errors):
        with journal.stage("manipulation 1"):
            journal.on_stage = no_room
            for error in errors:
                raise error

    journal = Journal()
    with pytest.raises(ArmStoppedError):
        staged(journal, ArmStoppedError("met something", Cause.COLLISION))
    assert "the end of 'manipulation 1' is not recorded" in journal.warnings[0]
    with pytest.raises(OSError, match="No space"):
        staged(Journal())  # nothing else went wrong


@pytest.mark.parametrize("stopped", [True, False])
def test_a_recording_that_cannot_be_read_is_none_and_hides_no_stop(tmp_path, stopped):
    """What is felt would be learnt from half a motion."""
    session = session_of(tmp_path, [])
    session.link.recording = lambda seq: b"half of one"

    def damaged(mcap):
        raise RecordingError("cut off")

    def move(sent):
        sent.append(module.Sent(module.Motion(None, "push 1"), 1, 0, 0.0))
        if stopped:
            raise ArmStoppedError("met something", Cause.COLLISION)

    session.recorder.add_recording = damaged
    with pytest.raises(ArmStoppedError) if stopped else nullcontext():
        session.play(move)
    assert [one.recording for one in session.executed] == [None]
    assert "no executor recording of 'push 1': cut off" in session.journal.warnings


@pytest.mark.parametrize("stopped", [True, False])
def test_a_stop_on_a_full_disk_ends_the_run_as_a_stop(tmp_path, monkeypatch, stopped):
    """Neither the stage's end, nor the recording of the motion, nor the end of the run's own can be written."""
    session = session_of(tmp_path, [], recorder_error=OSError(errno.ENOSPC, "No space left on device"))
    session.link.recording = lambda seq: b""
    session.recorder.add_recording = no_room

    def move(sent):
        sent.append(module.Sent(module.Motion(None, "push 1"), 1, 0, 0.0))
        if stopped:
            raise ArmStoppedError("met something", Cause.COLLISION)

    def loop(session, *_):
        with session.journal.stage("push 1"):
            session.journal.on_stage = no_room
            session.play(move)

    monkeypatch.setattr(pipeline, "open_session", lambda *_: session)
    monkeypatch.setattr(pipeline, "_introduce", lambda record, session: None)
    monkeypatch.setattr(pipeline, "_loop", loop)
    monkeypatch.setattr(pipeline, "write_run_json", no_room)
    record = pipeline.run_task(session.settings, session.journal)
    assert record.code == (ExitCode.PROTECTION if stopped else ExitCode.NOT_READY)
    assert record.reason.startswith("met something" if stopped else f"{tmp_path}: No space left on device")
    assert record.reason.endswith("no run.json is left: No space left on device")


def test_a_long_stage_tells_on_a_terminal_what_it_is_at():
    shown = StringIO()
    journal = Journal(Console(file=shown, force_terminal=True, width=100))
    journal.doing("nothing is under way")
    with journal.stage("plan 1"):
        journal.doing("try 3")
        deadline = time.monotonic() + 5.0
        while "plan 1: try 3" not in shown.getvalue() and time.monotonic() < deadline:
            time.sleep(0.02)
    assert "plan 1: try 3" in shown.getvalue()
    assert "nothing is under way" not in shown.getvalue()
