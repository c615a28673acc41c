"""What every screen of the console may use."""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import viser

from s2r_host.console.feed import Feed
from s2r_host.console.jobs import Jobs
from s2r_host.console.operator import Operator
from s2r_host.console.playback import Playback
from s2r_host.console.run_index import RunIndex
from s2r_host.console.scene import CellScene
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import S2RError

logger = logging.getLogger(__name__)

Event = viser.GuiEvent


@dataclass(frozen=True, eq=False)
class Context:
    """The parts of one console, shared by its screens.

    ``cell_options`` are what brings another command to this console's executor and camera, None where it has none.
    """

    server: viser.ViserServer
    arm: ArmDescription
    feed: Feed
    operator: Operator
    scene: CellScene
    playback: Playback
    runs: RunIndex
    jobs: Jobs
    endpoint: str
    camera: str
    cell_options: Mapping[str, str | None]
    runs_root: Path

    def tell(self, event: Event, title: str, text: str, color: str = "blue") -> None:
        """Show a notification in the browser an event came from."""
        if event.client is not None:
            event.client.add_notification(title, text, auto_close_seconds=8.0, color=color)  # type: ignore[arg-type]

    def on_click(self, button: viser.GuiButtonHandle, act: Callable[[Event], str | None]) -> None:
        """Attach an action: what it returns is told, what it raises is told in red; a bug is logged as well."""
        button.on_click(self.guarded(button.label, act))

    def guarded(self, what: str, act: Callable[[Event], str | None]) -> Callable[[Event], None]:
        """The action with its outcome shown to whoever asked for it."""

        @functools.wraps(act)
        def run(event: Event) -> None:
            try:
                said = act(event)
            except S2RError as error:
                self.tell(event, f"{what}: not done", str(error), "red")
            except Exception as error:
                logger.exception("'%s' failed", what)
                self.tell(event, f"{what}: a bug", f"{type(error).__name__}: {error}", "red")
            else:
                if said:
                    self.tell(event, what, said, "green")

        return run

    def at_once(
        self, what: str, act: Callable[[Event], str | None]
    ) -> Callable[[Event], Coroutine[Any, Any, None]]:
        """As :meth:`guarded`, in a thread of its own.

        viser carries out 32 actions at a time, and each may wait for the arm: a drag of the speed slider asks for more.
        """
        run = self.guarded(what, act)

        async def begin(event: Event) -> None:
            threading.Thread(target=run, args=(event,), name="s2r-console-at-once", daemon=True).start()

        return begin


def browser_of(event: Event) -> int:
    """Number of the browser an event came from; -1 is nobody's."""
    return -1 if event.client_id is None else event.client_id
