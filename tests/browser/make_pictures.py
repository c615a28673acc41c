"""Pictures of the console's screens and of written pages, in headless Chromium: for the docs, and to look at.

    python tests/browser/make_pictures.py --runs runs --out build/pictures
    python tests/browser/make_pictures.py --page runs/demo/run/report.html --out build/pictures
    python tests/browser/make_pictures.py --rrd run.rrd --out build/pictures

The console runs on a stand-in of its own that moves while the pictures are taken. A software renderer needs about a
minute of CPU for all of it.
"""

from __future__ import annotations

import argparse
import contextlib
import shutil
import socket
import subprocess
import sys
import threading
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from playwright.sync_api import Browser, Page, sync_playwright

from s2r_host.errors import ArmStoppedError
from s2r_host.link import ExecutorLink
from s2r_host.testing.cell import quintic_motion
from s2r_protocol.arms import load_arm
from s2r_protocol.cli.peers import free_port, peer, stand_in_cell

ARM = load_arm("xmate3pro")
FLAGS = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
# Drawing 3D in software would take both cores: two frames a second are enough for a picture.
FEW_FRAMES = """
window.requestAnimationFrame = act => setTimeout(() => act(performance.now()), 500);
window.cancelAnimationFrame = clearTimeout;
"""
DESKTOP, PHONE = {"width": 1180, "height": 780}, {"width": 390, "height": 800}
WAIT_MS = 180_000


def open_page(browser: Browser, viewport: dict[str, int]) -> Page:
    page = browser.new_page(viewport=viewport)
    page.set_default_timeout(WAIT_MS)
    page.add_init_script(FEW_FRAMES)
    return page


def take(page: Page, out: Path, name: str, **options: bool) -> None:
    for frame in page.frames:  # viser's word on software rendering would hide what the picture is of
        frame.evaluate(
            "() => document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())"
        )
    page.wait_for_timeout(1500)
    page.screenshot(path=out / f"{name}.png", timeout=WAIT_MS, **options)
    print(out / f"{name}.png", flush=True)


def press(page: Page, name: str) -> None:
    page.get_by_role("button", name=name).first.dispatch_event("click")


def open_tab(page: Page, name: str) -> None:
    page.get_by_role("tab", name=name, exact=True).click(force=True)


@contextlib.contextmanager
def swaying(executor: str):
    """The arm moves to and fro until the block ends."""
    ended = threading.Event()

    def sway() -> None:
        sign = 1.0
        with ExecutorLink(executor, ARM) as link, link.leased():
            link.arm_drives()
            while not ended.is_set():
                plan = quintic_motion(np.asarray(link.status().q_ref), sign * np.full(ARM.dof, 0.3), 6.0)
                with contextlib.suppress(ArmStoppedError):
                    link.wait_done(link.send_plan(plan, "sway"))
                sign = -sign

    thread = threading.Thread(target=sway)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def console_pictures(browser: Browser, runs: Path, out: Path) -> None:
    with TemporaryDirectory() as root, stand_in_cell(Path(root), ("--seed", "3"), pace=1.0) as cell:
        options = ("--executor", cell.executor, "--camera", cell.camera, "--port", "0", "--runs", runs)
        with peer("console", ("console", *options), Path(root)), swaying(cell.executor):
            page = open_page(browser, DESKTOP)
            page.goto((Path(root) / "console.ready").read_text().strip())
            page.get_by_role("button", name="STOP").wait_for()
            page.get_by_text("The arm is moving").first.wait_for()
            take(page, out, "console-run")
            open_tab(page, "Joints")
            page.get_by_text("joint7", exact=True).first.wait_for()
            take(page, out, "console-joints")
            open_tab(page, "Timing")
            page.get_by_text("Who is to blame").wait_for()
            take(page, out, "console-timing")
            open_tab(page, "Runs")
            take(page, out, "console-runs")
            press(page, "Open in 3D")
            page.get_by_text("not the live arm").first.wait_for()
            take(page, out, "console-runs-open")
            press(page, "Back to the live arm")
            open_tab(page, "Compare")
            take(page, out, "console-compare-empty")
            press(page, "Compare")
            page.get_by_text("RMS residual").wait_for()
            take(page, out, "console-compare")
            open_tab(page, "Gap")
            take(page, out, "console-gap")
            page.close()


def page_pictures(browser: Browser, path: Path, out: Path) -> None:
    for name, viewport in (("desktop", DESKTOP), ("phone", PHONE)):
        page = open_page(browser, viewport)
        page.goto(path.resolve().as_uri())
        page.wait_for_timeout(12_000)  # with few frames the player fades in slowly
        take(page, out, f"{path.stem}-{name}")
        take(page, out, f"{path.stem}-{name}-whole", full_page=True)
        page.close()


def rerun_picture(browser: Browser, rrd: Path, out: Path) -> None:
    """Rerun's own web viewer on a file from `s2r log export --to rrd`."""
    grpc, web = free_port(), free_port()
    command = [Path(sys.executable).with_name("rerun"), rrd, "--serve-web", "--port", str(grpc)]
    with subprocess.Popen([*command, "--web-viewer-port", str(web)], stderr=subprocess.DEVNULL) as server:
        try:
            page = open_page(browser, {"width": 1280, "height": 800})
            while not _listens(web):
                page.wait_for_timeout(200)
            page.goto(
                f"http://127.0.0.1:{web}/?renderer=webgl&url=rerun%2Bhttp%3A%2F%2F127.0.0.1%3A{grpc}%2Fproxy"
            )
            page.wait_for_timeout(60_000)  # it decodes and draws in software; nothing in its page says when
            page.screenshot(path=out / "rerun.png", timeout=WAIT_MS)
            page.close()
        finally:
            server.terminate()


def _listens(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--runs", type=Path, help="Folder with runs and gap answers: pictures of the console."
    )
    parser.add_argument(
        "--page", type=Path, action="append", default=[], help="An HTML file: pictures of it."
    )
    parser.add_argument("--rrd", type=Path, help="A Rerun file: a picture of it in Rerun's viewer.")
    parser.add_argument("--out", type=Path, required=True)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=FLAGS)
        for path in options.page:
            page_pictures(browser, path, options.out)
        if options.runs:
            console_pictures(browser, options.runs, options.out)
        if options.rrd:
            rerun_picture(browser, options.rrd, options.out)
        browser.close()


if __name__ == "__main__":
    main()
