"""The operator's page in a real browser: every screen, STOP, and a viewer that can move nothing."""

from __future__ import annotations

import pytest

from s2r_host.errors import ArmStoppedError
from s2r_host.link import ExecutorLink
from s2r_protocol.arms import load_arm
from s2r_protocol.faults import Cause, ExecutorState

# A page with 3D in a software renderer fills both cores for minutes: `make prove` runs it.
pytestmark = [pytest.mark.prove, pytest.mark.timeout(600)]
ARM = load_arm("xmate3pro")


def status(cell):
    with ExecutorLink(cell.executor, ARM) as link:
        return link.status()


def test_the_page_says_what_the_arm_does_and_that_stop_is_software(page):
    page.get_by_text("The arm holds its position").first.wait_for()
    assert "software stop" in page.get_by_role("button", name="STOP").inner_text()
    assert page.get_by_text("the emergency stop is hardware").is_visible()
    page.get_by_text("nobody", exact=True).first.wait_for()  # the lease


@pytest.mark.parametrize("how", ["click", "space"])
def test_stop_reaches_the_executor_while_another_host_moves_the_arm(do, page, cell, moving, how):
    ended = moving(20.0)
    page.get_by_text("The arm is moving").first.wait_for()
    if how == "click":
        do.press(page, "STOP")
    else:
        page.keyboard.press("Space")
    do.until(lambda: len(ended) == 2)
    assert isinstance(ended[1], ArmStoppedError), ended[1]
    assert ended[1].cause == Cause.STOP_REQUESTED
    assert status(cell).state == ExecutorState.HOLD


def test_a_viewer_moves_nothing(do, page, cell):
    before = status(cell)
    for name in ("Enable drives", "Disable drives", "Resume"):
        button = page.get_by_role("button", name=name)
        button.wait_for()
        assert button.is_disabled()
        button.evaluate("b => { b.disabled = false; b.removeAttribute('disabled'); b.click(); }")
    do.open_tab(page, "Runs")
    do.press(page, "Run again on this arm")
    page.get_by_text("this page has no control").first.wait_for()
    after = status(cell)
    assert (after.state, after.epoch, after.lease_holder) == (before.state, before.epoch, "")


def test_control_enables_the_buttons_for_one_page_only_and_ends_with_it(do, page, browser, cell):
    do.press(page, "Take control")
    do.until(lambda: status(cell).lease_holder.startswith("host:"))
    other = do.open_console(browser, cell)
    other.get_by_role("button", name="Take control").wait_for()
    do.press(other, "Disable drives")
    other.get_by_text("this page has no control").first.wait_for()
    assert status(cell).state == ExecutorState.HOLD
    other.close()
    do.press(page, "Disable drives")
    do.until(lambda: status(cell).state == ExecutorState.DISARMED)
    do.press(page, "Enable drives")
    do.until(lambda: status(cell).state == ExecutorState.HOLD)
    page.close()
    do.until(lambda: status(cell).lease_holder == "")


def test_joints_show_limits_and_use(do, page):
    do.open_tab(page, "Joints")
    page.get_by_text("joint7", exact=True).first.wait_for()
    page.get_by_text("N·m").first.wait_for()
    assert page.get_by_text("%").count() >= 14


def test_timing_shows_lateness_and_who_is_to_blame(do, page):
    do.open_tab(page, "Timing")
    page.get_by_text("Lateness of ticks").wait_for()
    page.get_by_text("Who is to blame").wait_for()
    page.get_by_text("bus load").first.wait_for()


def test_runs_are_listed_filtered_and_opened(do, page):
    do.open_tab(page, "Runs")
    page.get_by_text("drawer at +0.1514 m").first.wait_for()
    page.get_by_text("second", exact=True).first.wait_for()
    words = page.locator("input:visible").first
    words.fill("nothing like this")
    page.get_by_text("no run matches 'nothing like this'").wait_for()
    words.fill("first")
    do.until(lambda: not page.get_by_text("second", exact=True).count())
    do.press(page, "Open in 3D")
    page.get_by_text("first, not the live arm").wait_for()
    do.press(page, "Back to the live arm")


def test_a_run_is_compared_with_its_twin_and_the_worst_is_shown(do, page):
    do.open_tab(page, "Compare")
    page.get_by_text("Choose two runs, or a run and its twin").wait_for()
    do.press(page, "Compare")
    page.get_by_text("RMS residual [mrad]").wait_for()
    page.get_by_text("framed: the worst").wait_for()
    do.press(page, "Jump to the worst in 3D")
    page.get_by_text("manipulation 1, not the live arm").wait_for()
    do.open_tab(page, "Runs")
    do.press(page, "Open in 3D")
    do.press(page, "Back to the live arm")


def test_a_gap_answer_is_shown_with_its_evidence(do, page):
    do.open_tab(page, "Gap")
    page.get_by_text("physics is missing").wait_for()
    page.get_by_text("coulomb_friction on joint4, probability 0.98").wait_for()
    page.get_by_text("0.25 N·m (0.24 to 0.26)").wait_for()
    page.get_by_text("position [mrad]").wait_for()
