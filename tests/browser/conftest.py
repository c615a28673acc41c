"""A cell, a console with two runs and a gap answer, and a headless Chromium; skipped where no browser is."""

from __future__ import annotations

import json
import os
import shutil
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from s2r_host.link import ExecutorLink
from s2r_host.recording import RunRecorder
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.peers import peer, stand_in_cell

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
pytest.importorskip("s2r_executor._native", reason="the native core is not built")

ARM = load_arm("xmate3pro")
WAIT_MS = 120_000
CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome") if (path := shutil.which(name))), None
)
# Drawing 3D in software takes every core there is; two frames a second leave them to the page and the arm.
FEW_FRAMES = """
window.requestAnimationFrame = act => setTimeout(() => act(performance.now()), 500);
window.cancelAnimationFrame = clearTimeout;
"""
STEP = np.array([0.4, 0.2, -0.2, -0.2, 0.3, 0.2, 0.4])


def move(q0, step, duration_s, knots=60):
    """A motion at rest at both ends."""
    t = np.linspace(0.0, duration_s, knots)
    x = t / duration_s
    s, ds = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / duration_s
    dds = 60 * x * (1 - x) * (1 - 2 * x) / duration_s**2
    q0 = np.array(q0)
    return SimpleNamespace(t=t, q=q0 + s[:, None] * step, dq=ds[:, None] * step, ddq=dds[:, None] * step)


@pytest.fixture(scope="session")
def cell(tmp_path_factory):
    """Stand-in, executor and console, with two finished runs and a gap answer in the console's runs folder."""
    folder = tmp_path_factory.mktemp("browser")
    with stand_in_cell(folder, ("--seed", "3"), pace=1.0) as running:
        (folder / "runs/first").mkdir(parents=True)
        _record_run(running, folder / "runs/first")
        shutil.copytree(folder / "runs/first", folder / "runs/second")
        _write_gap_answer(folder / "runs/answer")
        options = ("--executor", running.executor, "--camera", running.camera, "--port", "0")
        with peer("console", ("console", *options, "--runs", folder / "runs"), folder):
            url = (folder / "console.ready").read_text().strip()
            yield SimpleNamespace(url=url, executor=running.executor, folder=folder, runs=folder / "runs")


def _record_run(running, folder: Path) -> None:
    """What `s2r run` leaves behind, of one short motion: the console needs no more."""
    with (
        ExecutorLink(running.executor, ARM) as link,
        RunRecorder(folder / "run.mcap", "/lab/xmate3pro", ARM.joint_names, ARM) as recorder,
        link.leased(),
    ):
        link.arm_drives()
        plan = move(link.status().q_ref, 0.2 * STEP, 1.0)
        verdict = link.send_plan(plan, "manipulation 1")
        recorder.add_plan(plan, "manipulation 1", verdict.seq)
        link.wait_done(verdict)
        recorder.add_recording(link.recording(verdict.seq))
    run = {
        "task": "drawer",
        "arm": {"name": "xmate3pro"},
        "s_target": 0.15,
        "delta": -0.0014,
        "exit": {"code": 0, "name": "OK", "reason": "drawer at +0.1514 m"},
        "verdicts": [{}],
        "wall_s": 3.0,
        "inputs": {"settings": {"seed": 3}, "arguments": ["run", "drawer", "--target", "0.15"]},
    }
    (folder / "run.json").write_text(json.dumps(run))


def _write_gap_answer(folder: Path) -> None:
    folder.mkdir()
    answer = {
        "verdict": "physics_missing",
        "where": [{"joint": "joint4", "share": 0.9, "regime": {"words": "throughout the motion"}}],
        "effects": [{"name": "coulomb_friction", "joint": "joint4", "probability": 0.98,
                     "parameters": {"level": {"value": 0.25, "unit": "N·m", "interval90": [0.24, 0.26]}}}],
        "fit": {"unit": "rad", "holdout_before": 0.0024, "holdout_after": 0.0004},
    }  # fmt: skip
    (folder / "gap.json").write_text(json.dumps(answer))


@pytest.fixture(scope="session")
def browser():
    """Headless Chromium with software rendering: what a bare machine has."""
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine: apt-get install chromium")
    flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_api.sync_playwright() as playwright:
        started = playwright.chromium.launch(executable_path=CHROMIUM, args=flags)
        yield started
        started.close()


def open_console(browser, cell):
    """A page of its own on the console."""
    opened = browser.new_page(viewport={"width": 760, "height": 640})
    opened.set_default_timeout(WAIT_MS)
    opened.add_init_script(FEW_FRAMES)
    opened.goto(cell.url)
    opened.get_by_role("button", name="STOP").wait_for()
    return opened


@pytest.fixture
def page(browser, cell):
    """The console, open and usable."""
    opened = open_console(browser, cell)
    yield opened
    pictures = os.environ.get("S2R_SCREENSHOTS")
    if pictures:
        Path(pictures).mkdir(parents=True, exist_ok=True)
        opened.screenshot(path=Path(pictures) / f"{time.time_ns()}.png", timeout=WAIT_MS)
    opened.close()


@pytest.fixture
def moving(cell):
    """Starts a slow motion in a thread of its own, as another host would; a list of how it ended."""
    ended: list[object] = []

    def run(duration_s: float) -> None:
        try:
            with ExecutorLink(cell.executor, ARM) as link, link.leased():
                link.arm_drives()
                home = ARM.q_home
                step = STEP if np.abs(link.status().q_ref - home).max() < 0.3 else -STEP
                verdict = link.send_plan(move(link.status().q_ref, step, duration_s), "slow")
                ended.append("started")
                ended.append(link.wait_done(verdict))
        except Exception as error:  # noqa: BLE001 - the test looks at it
            ended.append(error)

    threads: list[threading.Thread] = []

    def start(duration_s: float) -> list[object]:
        thread = threading.Thread(target=run, args=(duration_s,))
        thread.start()
        threads.append(thread)
        until(lambda: ended)
        return ended

    yield start
    with ExecutorLink(cell.executor, ARM) as link:
        link.stop()
    for thread in threads:
        thread.join(60)


def until(condition, timeout_s=60):
    """Poll until it holds."""
    deadline = time.monotonic() + timeout_s
    while not (found := condition()):
        assert time.monotonic() < deadline
        time.sleep(0.02)
    return found


def open_tab(page, name: str) -> None:
    """Open a screen. Playwright's own checks wait for frames, of which software rendering has few."""
    page.get_by_role("tab", name=name, exact=True).click(force=True, timeout=WAIT_MS)


def press(page, name: str) -> None:
    """Press a button as a user's click would arrive, without waiting for frames."""
    page.get_by_role("button", name=name).first.dispatch_event("click")


@pytest.fixture
def do():
    """What tests do with a page."""
    return SimpleNamespace(open_tab=open_tab, press=press, until=until, open_console=open_console)
