"""The console's page without a browser: what is on it, and what a click does."""

from __future__ import annotations

import asyncio
import contextlib
import json
import threading
import time
from types import SimpleNamespace

import numpy as np
import pytest
from viser._messages import CommandTriggerMessage, GuiUpdateMessage

from s2r_host.console.app import STOP_LABEL, Console
from s2r_host.console.feed import Feed
from s2r_host.console.live_run import RunSight
from s2r_host.console.playback import Opened
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.peers import free_port
from s2r_protocol.exits import RefusedError
from s2r_protocol.keys import ArmKeys
from s2r_protocol.session import Role, listen

ARM = load_arm("xmate3pro")


@pytest.fixture
def opened(tmp_path):
    """``opened()`` makes a console that no executor answers and no browser looks at, on runs in ``tmp_path``."""
    nobody = "tcp/127.0.0.1:1"
    with contextlib.ExitStack() as ends:
        yield lambda: ends.enter_context(
            contextlib.closing(Console(ARM, ArmKeys("lab", ARM.name), nobody, nobody, tmp_path))
        )


def test_an_executor_that_starts_after_the_console_is_heard(tmp_path):
    keys, endpoint = ArmKeys("lab", ARM.name), f"tcp/127.0.0.1:{free_port()}"
    with contextlib.closing(Console(ARM, keys, endpoint, endpoint, tmp_path)) as page:
        time.sleep(0.3)
        with listen([endpoint], Role.EXECUTOR, keys) as late:
            deadline = time.monotonic() + 10.0
            while not page._feed.health().alive:
                assert time.monotonic() < deadline
                late.put(Feed.key("executor_state", f"/{keys.base}"), b"")
                time.sleep(0.1)


@pytest.mark.parametrize(
    "answer",
    [
        {"verdict": "physics_missing", "where": [{}], "effects": []},
        {"verdict": "physics_missing", "where": [], "effects": [{"name": "play"}]},
        {"verdict": "physics_missing", "where": {}, "effects": 3},
        {"verdict": "unknown", "where": [], "effects": [], "fit": []},
    ],
)
def test_a_gap_answer_of_another_release_is_told_and_the_page_lives(opened, tmp_path, answer):
    (tmp_path / "old").mkdir()
    (tmp_path / "old/gap.json").write_text(json.dumps(answer))
    page = opened()
    assert "is no answer of &#x27;s2r gap&#x27; as this release writes it" in page._gap._html.content
    page._slow()


def write_runs(root, number):
    run = {
        "task": "drawer", "arm": {"name": ARM.name}, "s_target": 0.1, "delta": 0.0, "verdicts": [], "wall_s": 1.0,
        "exit": {"code": 0, "name": "OK", "reason": "there"}, "inputs": {"settings": {"seed": 0}, "arguments": []},
    }  # fmt: skip
    for k in range(number):
        (root / f"run-{k:03d}").mkdir(exist_ok=True)
        (root / f"run-{k:03d}/run.json").write_text(json.dumps(run))


def test_runs_that_have_no_row_are_told(opened, tmp_path):
    write_runs(tmp_path, 12)
    page = opened()
    screen = page._runs_screen
    assert "the newest 12" not in screen._list.content
    write_runs(tmp_path, 13)
    screen.refresh_list()
    assert "the newest 12 of 13; choose any below" in screen._list.content
    write_runs(tmp_path, 205)
    screen.refresh_list()
    assert "the newest 12 of 205; the newest 200 are below, the filter finds any" in screen._list.content
    screen._filter.value = "run-00"
    screen.refresh_list()
    assert "the newest" not in screen._list.content


@pytest.mark.parametrize(
    ("loop", "fails", "last"),
    [
        ("_slow", "_joints.refresh_plots", "_show_plan_path"),
        ("_write", "_write_header", "_runs_screen.refresh_texts"),
    ],
)
def test_a_part_of_the_page_that_fails_takes_no_other_with_it(opened, monkeypatch, caplog, loop, fails, last):
    page, reached = opened(), []

    def fail():
        raise ValueError("of another release")

    for name, act in ((fails, fail), (last, lambda: reached.append(last))):
        *owner, method = name.split(".")
        monkeypatch.setattr(getattr(page, owner[0]) if owner else page, method, act)
    for _ in range(3):
        getattr(page, loop)()
    assert reached == [last] * 3
    assert caplog.text.count("could not update a part of the page") == 1


def test_from_a_comparison_there_is_a_way_back_to_the_live_arm(opened):
    page = opened()
    screen, playback = page._runs_screen, page._context.playback
    t = np.linspace(0.0, 2.0, 5)
    playback.open(
        Opened("manipulation 1", t, np.zeros((5, 7)), None), 1.5
    )  # as 'Jump to the worst in 3D' does
    page._write()
    assert (screen._live.visible, screen._time.visible) == (True, True)
    assert (screen._time.max, screen._time.value) == (2.0, 1.5)
    playback.open(None)
    page._write()
    assert (screen._live.visible, screen._time.visible) == (False, False)


@pytest.mark.parametrize("how", ["click", "space"])
def test_stop_does_not_wait_for_what_was_asked_before(opened, monkeypatch, how):
    """viser carries out 32 actions at a time; a drag of the speed slider behind a slow command asks for more."""
    page, stopped, go_on = opened(), threading.Event(), threading.Event()
    monkeypatch.setattr(page._operator, "stop", stopped.set)
    gui, pool = page._server.gui, page._server._thread_executor
    monkeypatch.setattr(gui, "_resolve_client", lambda client_id: SimpleNamespace(add_notification=print))
    for _ in range(40):
        pool.submit(go_on.wait, 60.0)
    if how == "click":
        (stop,) = (
            b for b in gui._gui_input_handle_from_uuid.values() if getattr(b, "label", "") == STOP_LABEL
        )
        clicked = GuiUpdateMessage(stop._impl.uuid, {"value": True})
        asyncio.run_coroutine_threadsafe(gui._handle_gui_updates(1, clicked), page._server._event_loop)
    else:
        (stop,) = gui._command_handle_from_uuid.values()
        pressed = CommandTriggerMessage(stop._impl.uuid)
        asyncio.run_coroutine_threadsafe(gui._handle_command_trigger(1, pressed), page._server._event_loop)
    assert stopped.wait(10.0)
    go_on.set()


def test_a_run_again_is_in_the_consoles_own_cell_with_its_own_places(opened, monkeypatch):
    """The run was of another cell, with certificates that this console was not started with."""
    page = opened()
    line = ("run", "drawer", "--cell", "elsewhere", "--tls", "keys", "--executor=tcp/old:1")
    monkeypatch.setattr(
        page._runs_screen, "entry", lambda: SimpleNamespace(name="old", arguments=line, told=None)
    )
    monkeypatch.setattr(page._operator, "require", lambda browser: None)
    monkeypatch.setattr(page._operator, "lend_lease", lambda browser, start: start())
    started = []
    monkeypatch.setattr(page._context.jobs, "start", lambda title, arguments: started.extend(arguments))
    page._runs_screen._again(SimpleNamespace(client_id=1, client=None))
    assert started[:3] == ["run", "drawer", "--out"]
    assert started[4:] == ["--executor", "tcp/127.0.0.1:1", "--camera", "tcp/127.0.0.1:1", "--cell", "lab"]


def test_a_run_that_was_told_no_target_is_refused_before_the_lease_is_lent(opened, monkeypatch):
    page = opened()
    entry = SimpleNamespace(name="old", arguments=("run", "drawer", "--target", "ask"), told=None)
    monkeypatch.setattr(page._runs_screen, "entry", lambda: entry)
    monkeypatch.setattr(page._operator, "require", lambda browser: None)
    with pytest.raises(RefusedError, match="told none"):
        page._runs_screen._again(SimpleNamespace(client_id=1, client=None))


def test_while_a_run_that_was_started_here_goes_on_nothing_else_can_be_asked_of_the_arm(opened):
    page = opened()
    operator, screen = page._operator, page._run
    operator._controller, operator._borrower_runs = 1, lambda: True
    screen.refresh(None)
    assert "Browser 1 has control; a run started here has the lease." in screen._control.content
    assert all(handle.disabled for handle in (*screen._moving, screen._speed))
    operator._borrower_runs = lambda: False
    screen.refresh(None)
    assert not any(handle.disabled for handle in (*screen._moving, screen._speed))


def test_an_answer_that_was_written_again_is_shown_anew(opened, tmp_path):
    path = tmp_path / "answer/gap.json"
    path.parent.mkdir()
    path.write_text(json.dumps({"verdict": "nothing_missing", "where": [], "effects": []}))
    page = opened()
    assert "nothing is missing" in page._gap._html.content
    path.write_text(json.dumps({"verdict": "unknown", "where": [], "effects": []}))
    page._slow()
    assert "something unknown is missing" in page._gap._html.content


def test_what_another_run_saw_is_not_shown_as_this_ones(opened, monkeypatch, tmp_path):
    page = opened()
    scene, cloud = page._context.scene, np.full((3, 3), 0.5)
    axis = (np.zeros(3), np.array([1.0, 0.0, 0.0]), "prismatic")
    sights = [RunSight(tmp_path / "a", [], 2, cloud, axis=axis), RunSight(tmp_path / "b", [], 0)]
    monkeypatch.setattr(page._watch, "look", lambda: sights[0])
    page._slow()
    drawn = list(scene._axis)
    page._slow()
    assert scene._cloud is not None
    assert scene._axis == drawn  # and it is not drawn anew every second
    monkeypatch.setattr(page._watch, "look", lambda: sights[1])
    page._slow()
    assert (scene._cloud, scene._axis) == (None, [])


def test_no_arm_is_drawn_before_it_is_known_where_its_joints_are(opened):
    """All bodies lay in a heap at the base."""
    page = opened()
    page._draw()
    arms = page._context.scene.real, page._context.scene.plan, page._context.scene.twin
    assert [arm.visible for arm in arms] == [False] * 3
    page._context.playback.open(Opened("old run", np.linspace(0.0, 1.0, 3), np.zeros((3, 7)), None))
    page._draw()
    assert arms[0].visible
    assert "old run, not the live arm" in page._header_markup()
    page._context.playback.open(None)
    page._draw()
    assert not arms[0].visible
