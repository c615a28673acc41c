"""How long a plan may take, and who is told how far it is."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

from s2r_host.errors import HostError
from s2r_protocol.exits import RefusedError


class TimeIsUpError(HostError, RefusedError):
    """Planning took longer than was allowed; the text says how far it got."""


def _tell_nobody(text: str) -> None:
    del text


@dataclass(eq=False)
class Patience:
    """A wall-clock limit and an audience. The limit ends a search; it never changes a plan.

    Attributes:
        limit_s: Time from the creation of this object after which planning is given up; None: never.
        tell: Gets a few words at every control step.
        control_steps: Control steps announced so far, over all attempts.
    """

    limit_s: float | None = None
    tell: Callable[[str], None] = _tell_nobody
    started_s: float = field(default_factory=time.perf_counter)
    control_steps: int = 0

    def step(self, what: str) -> None:
        """Announce a control step; see :meth:`check`."""
        self.control_steps += 1
        self.check(what)

    def check(self, what: str) -> None:
        """Tell the audience what is being done.

        Raises:
            TimeIsUpError: The limit has passed.
        """
        self.tell(what)
        if self.limit_s is not None and time.perf_counter() - self.started_s > self.limit_s:
            raise TimeIsUpError(f"no plan within the time limit of {self.limit_s:g} s; given up at: {what}")
