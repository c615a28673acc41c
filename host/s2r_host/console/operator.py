"""Who may do what from the console: anybody may stop, one browser at a time may move.

The console takes the executor's lease when a browser asks for control, and gives it back when that browser leaves,
asks for it, or starts a job that needs the lease itself. Every request names the browser it comes from; the page's
greyed-out buttons are a courtesy, this is the check.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from s2r_host.cli_stop import send_stop
from s2r_host.errors import CommandRefusedError, PeerUnreachableError
from s2r_host.link import ExecutorLink
from s2r_protocol.arms import ArmDescription
from s2r_protocol.exits import RefusedError, S2RError
from s2r_protocol.faults import Refusal
from s2r_protocol.keys import ArmKeys

logger = logging.getLogger(__name__)

CONNECT_TIMEOUT_S = 1.0
STOP_TIMEOUT_S = 2.0
T = TypeVar("T")


class NoControlError(RefusedError):
    """This browser does not have control."""


class Operator:
    """Commands to one executor on behalf of browsers, known by their numbers. Thread-safe."""

    def __init__(
        self,
        endpoint: str,
        arm: ArmDescription,
        keys: ArmKeys,
        tls: Path | None = None,
        view_only: bool = False,
    ) -> None:
        self._endpoint, self._arm, self._keys, self._tls = endpoint, arm, keys, tls
        self.view_only = view_only
        self._lock = threading.RLock()
        self._link: ExecutorLink | None = None
        self._controller: int | None = None
        self._leased = False
        self._borrower_runs: Callable[[], bool] = lambda: False

    @property
    def can_stop(self) -> bool:
        """Whether a stop may be sent: with certificates, view-only is the monitor's, which commands nothing."""
        return not (self.view_only and self._tls is not None)

    @property
    def controller(self) -> int | None:
        """The browser in control."""
        return self._controller

    @property
    def has_lease(self) -> bool:
        """The console holds the executor's lease now."""
        return self._leased

    @property
    def lent(self) -> bool:
        """A job that the lease was lent to is under way: it takes it for each of its motions."""
        return self._borrower_runs()

    def connect(self) -> None:
        """Open the link ahead of time, so that a stop need not.

        Raises:
            PeerUnreachableError: Nobody answers.
            ArmMismatchError: The executor runs another arm or other limits.
        """
        with self._lock:
            if self._link is None and self.can_stop:
                self._link = ExecutorLink(
                    self._endpoint, self._arm, self._keys, CONNECT_TIMEOUT_S, STOP_TIMEOUT_S, self._tls
                )

    @property
    def connected(self) -> bool:
        """The link is open."""
        return self._link is not None

    def stop(self) -> str:
        """Stop on the path. Needs no control; never waits for another command under way.

        Returns:
            One sentence for the operator.

        Raises:
            PeerUnreachableError: Nothing was stopped.
            CommandRefusedError: The executor would not.
            NoControlError: This console reads only, :attr:`can_stop`.
        """
        if not self.can_stop:
            raise NoControlError(
                "nothing was stopped: with --view-only and --tls this console has the monitor's certificate, which "
                "cannot stop the arm; use 's2r stop --tls DIR' with the host's, or the emergency stop"
            )
        link = self._link
        if link is not None:
            try:
                verdict = link.stop()
                return f"stop accepted (epoch {verdict.epoch})"
            except Exception as error:  # noqa: BLE001 - also a link that is being closed: a stop goes out all the same
                logger.warning("stop over the open link failed (%s); trying a new one", error)
        verdict, _ = send_stop(self._endpoint, self._keys, STOP_TIMEOUT_S, self._tls)
        return f"stop accepted (epoch {verdict.epoch})"

    def take_control(self, browser: int) -> None:
        """Take the lease for a browser; while it is lent, only the control.

        Raises:
            NoControlError: Another browser has control, or the console was started view-only.
            CommandRefusedError: Somebody else holds the lease.
        """
        with self._lock:
            if self.view_only:
                raise NoControlError(
                    "this console was started with --view-only; start one without it to move the arm"
                )
            if self._controller not in (None, browser):
                raise NoControlError(f"browser {self._controller} has control; it has to give it back first")
            if not (self._leased or self.lent):
                self._on_link(_take_lease)
                self._leased = True
            self._controller = browser

    def give_back(self, browser: int) -> None:
        """Return the lease if this browser has control; harmless otherwise."""
        with self._lock:
            if self._controller != browser:
                return
            self._controller = None
            self._return_lease()

    def lend_lease(self, browser: int, start: Callable[[], Callable[[], bool]]) -> None:
        """Return the lease but keep control, and start a job of this browser's that takes it.

        The job plans between its motions, with the lease free: whoever takes it then ends the run.

        Args:
            browser: Its number.
            start: Starts the job; returns what tells whether it is still under way.

        Raises:
            NoControlError: This browser has no control.
        """
        with self._lock:
            self._require(browser)
            self._return_lease()
            self._borrower_runs = start()

    def _return_lease(self) -> None:
        if self._leased and self._link is not None:
            self._leased = False
            try:
                self._link.return_lease()
            except S2RError as error:
                logger.warning("the lease was not returned: %s", error)
                self._drop_link()

    def command(self, browser: int, act: Callable[[ExecutorLink], T]) -> T:
        """Carry out a command of the browser in control, holding the lease.

        Raises:
            NoControlError: It has no control, or the lease is lent.
            S2RError: The executor refused, or does not answer.
        """
        with self._lock:
            self._require(browser)
            if self.lent:
                raise NoControlError(
                    "the run that this console started has the lease until it ends: STOP its motion, or cancel the "
                    "job on screen Runs"
                )
            if self._leased:
                self._on_link(lambda link: link.meet())  # a button pressed after a stop is the wish to go on
            else:
                self._on_link(_take_lease)
                self._leased = True
            try:
                return self._on_link(act)
            except CommandRefusedError as error:
                # Lost by silence: control is to be taken anew, and with it the lease.
                if error.code == Refusal.NO_LEASE:
                    self._drop_link()
                raise

    def require(self, browser: int) -> None:
        """Check that a browser has control.

        Raises:
            NoControlError: It has none.
        """
        with self._lock:
            self._require(browser)

    def _require(self, browser: int) -> None:
        if self._controller != browser:
            who = f"browser {self._controller} has it" if self._controller is not None else "nobody has it"
            raise NoControlError(f"this page has no control ({who}): press 'Take control' first")

    def _on_link(self, act: Callable[[ExecutorLink], T]) -> T:
        self.connect()
        if self._link is None:
            raise NoControlError("this console holds a monitor's certificate and commands nothing")
        try:
            return act(self._link)
        except PeerUnreachableError:
            self._drop_link()
            raise

    def _drop_link(self) -> None:
        link, self._link = self._link, None
        self._leased, self._controller = False, None
        if link is not None:
            threading.Thread(target=link.close, name="s2r-console-close", daemon=True).start()

    def executor_changed(self) -> None:
        """The executor was restarted or has gone: the link and the lease are void."""
        with self._lock:
            self._drop_link()

    def close(self) -> None:
        """Give everything back."""
        with self._lock:
            link, self._link = self._link, None
            self._leased = False
        if link is not None:
            link.close()


def _take_lease(link: ExecutorLink) -> None:
    link.meet()  # whoever asks for control has seen how the arm stands
    link.take_lease()
