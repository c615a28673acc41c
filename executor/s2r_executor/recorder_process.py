"""The process that writes recordings: fed over a socket by the front end, which never waits for a disk.

When the front end dies, the socket ends: all files are finished in good order. When this process dies, its files
lack at most the last half second and `s2r log recover` mends them. When the disk is full, whatever cannot be
written is counted, said, and tried again in a new file once there is room.
"""

from __future__ import annotations

import json
import select
import signal
import socket
import sys
import time
from pathlib import Path

from s2r_executor.observations import Encoder, Timeline
from s2r_executor.recorder_files import FileSettings, RecordingFiles
from s2r_executor.recorder_wire import Frame, PlanIdentity, batch_of, merged, receive, send
from s2r_executor.writer_settings import WriterSettings
from s2r_protocol.arms import load_arm

_RETRY_S = 2.0
_MERGED = 64


class Writer:
    """Turns frames into files and answers."""

    def __init__(self, settings: WriterSettings, connection: socket.socket) -> None:
        self._settings = settings
        self._connection = connection
        self._arm = load_arm(settings.arm)
        timeline = Timeline(settings.offset_ns, settings.tick_ns, settings.stepped)
        self._encoder = Encoder(self._arm, timeline)
        self._files: RecordingFiles | None = None
        self._reason = ""
        self._lost_ticks = 0
        self._retry_at_s = 0.0
        self._flushed_s = time.monotonic()
        self._open()

    def run(self) -> None:
        """Serve until the front end closes or dies."""
        period_s = self._settings.flush_period_s / 2  # a crash may cost one whole period, never more
        while True:
            frame = receive(self._connection) if self._waiting(period_s) else Frame({"kind": "idle"})
            batches: list[Frame] = []
            # Many small batches cost far more than one large one: after a pause, take what has queued up together.
            while frame is not None and frame.head["kind"] == "batch" and len(batches) < _MERGED:
                batches.append(frame)
                frame = receive(self._connection) if self._waiting(0.0) else Frame({"kind": "idle"})
            if batches:
                self._handle(merged(batches))
            if frame is None:
                self._finish()
                return
            self._handle(frame)
            if time.monotonic() - self._flushed_s >= period_s:
                self._flushed_s = time.monotonic()
                self._flush()

    def _waiting(self, timeout_s: float) -> bool:
        return bool(select.select([self._connection], [], [], timeout_s)[0])

    def _handle(self, frame: Frame) -> None:
        kind = frame.head["kind"]
        if self._files is None and time.monotonic() >= self._retry_at_s:
            self._open()
        if self._files is None:
            if kind == "batch":
                self._lost_ticks += int(frame.head["ticks"])
            elif kind == "plan":
                self._answer(int(frame.head["identity"]["seq"]), reason=f"not recorded: {self._reason}")
            return
        try:
            if kind == "batch":
                self._files.write(batch_of(frame))
            elif kind == "plan":
                self._files.open_plan(PlanIdentity(**frame.head["identity"]), frame.body)
            elif kind == "drop":
                dropped = self._files.discard(int(frame.head["plan_id"]))
                if dropped is not None:
                    self._completed(dropped, None)
        except OSError as error:
            self._lost_ticks += int(frame.head.get("ticks", 0))
            self._give_up(error)

    def _open(self) -> None:
        s = self._settings
        try:
            self._files = RecordingFiles(
                Path(s.directory),
                self._arm,
                s.namespace,
                self._encoder,
                FileSettings(s.chunk_bytes, s.publish_period_s),
                s.facts,
                self._completed,
            )
            self._files.flush()  # a full disk shows here, not a second later
        except OSError as error:
            self._give_up(error)
            return
        self._reason = ""
        self._say("session", path=str(self._files.session_path))

    def _flush(self) -> None:
        if self._files is not None:
            try:
                self._files.flush()
            except OSError as error:
                self._give_up(error)
        self._say("health", lost_ticks=self._lost_ticks, reason=self._reason)

    def _give_up(self, error: OSError) -> None:
        self._reason = f"{error.strerror or error} ({self._settings.directory})"
        self._retry_at_s = time.monotonic() + _RETRY_S
        if self._files is not None:
            self._files.abandon()
            self._files = None
        self._say("failed", reason=self._reason, lost_ticks=self._lost_ticks)

    def _finish(self) -> None:
        if self._files is not None:
            try:
                self._files.finish()
            except OSError as error:
                self._give_up(error)

    def _completed(self, identity: PlanIdentity, path: Path | None) -> None:
        if path is None:
            self._answer(identity.seq, reason=f"plan {identity.seq} never ran")
        else:
            self._answer(identity.seq, path=str(path))

    def _answer(self, seq: int, **values: str) -> None:
        self._say("answer", seq=seq, **values)

    def _say(self, kind: str, **values: object) -> None:
        try:
            send(self._connection, Frame({"kind": kind, **values}))
        except OSError:  # the front end has gone; what it sent before is still written
            self._reason = self._reason or "the front end has gone"


def main() -> None:
    """Entry point of the process."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):  # meant for the front end; its end is ours
        signal.signal(number, signal.SIG_IGN)
    connection = socket.socket(fileno=int(sys.argv[1]))
    Writer(WriterSettings(**json.loads(sys.argv[2])), connection).run()


if __name__ == "__main__":
    main()
