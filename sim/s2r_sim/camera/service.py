"""The camera on the wire: a Zenoh session of its own that answers one query with one frame."""

from __future__ import annotations

import logging
import os
import queue
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import zenoh

from s2r_protocol import codec, session
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.session import Role
from s2r_sim.camera.camera import View
from s2r_sim.camera.frame import to_message

logger = logging.getLogger(__name__)

_WAITING = 4  # captures that may wait for their turn


class CameraService:
    """Answers capture queries one after the other, in a thread of its own."""

    def __init__(
        self,
        listen: str,
        keys: ArmKeys,
        look: Callable[[], View],
        K: np.ndarray,
        X_base_camera: np.ndarray,
        world_commitment: str,
        camera: str = "front",
        tls: Path | None = None,
    ) -> None:
        """Listen and serve.

        Args:
            listen: Zenoh endpoint, e.g. ``tcp/127.0.0.1:7448``.
            keys: Cell and arm names.
            look: Takes one picture; called from the service's thread only.
            K, X_base_camera, world_commitment: Sent with every frame.
            camera: Its name.
            tls: Folder with the certificates, or None for this machine only.

        Raises:
            ListenError: The endpoint is taken.
            AddressError: The endpoint leaves this machine and there are no certificates.
            CertificateError: A certificate cannot be used.
        """
        self._camera, self._look, self._K, self._X = camera, look, K, X_base_camera
        self._world_commitment = world_commitment
        self._index = 0
        self._waiting: queue.Queue[zenoh.Query | None] = queue.Queue(_WAITING)
        self._session = session.listen([listen], Role.CAMERA, keys, tls)
        self._worker = threading.Thread(target=self._serve, name="camera", daemon=True)
        self._worker.start()
        self._session.declare_queryable(keys.capture(camera), self._take)

    def close(self) -> None:
        """Stop answering."""
        self._waiting.put(None)
        self._worker.join()
        self._session.close()

    def _take(self, query: zenoh.Query) -> None:
        try:
            self._waiting.put_nowait(query)
        except queue.Full:
            self._reply(
                query, pb.Frame(camera=self._camera, error=f"{_WAITING} captures are waiting already")
            )

    def _serve(self) -> None:
        while (query := self._waiting.get()) is not None:
            try:
                frame = self._frame(query)
            except Exception as error:  # the only worker must outlive it
                logger.exception("capture %d failed", self._index)
                frame = pb.Frame(camera=self._camera, error=f"capture failed: {error}")
            self._reply(query, frame)

    def _frame(self, query: zenoh.Query) -> pb.Frame:
        try:
            wire = query.payload.to_bytes() if query.payload is not None else b""
            request = codec.open_body(codec.open_envelope(wire), pb.CaptureRequest)
        except codec.MessageRefusedError as error:
            return pb.Frame(camera=self._camera, error=f"capture refused: {error}")
        if request.camera not in ("", self._camera):
            text = f"unknown camera {request.camera!r}; this process has {self._camera!r}"
            return pb.Frame(camera=self._camera, error=text)
        stamp_ns = time.monotonic_ns()
        view = self._look()
        self._index += 1
        frame = to_message(view, self._camera, self._index, stamp_ns, self._K, self._X)
        frame.world_commitment = self._world_commitment
        return frame

    def _reply(self, query: zenoh.Query, frame: pb.Frame) -> None:
        address = codec.Address(sender=f"camera:{os.getpid()}", seq=self._index)
        try:
            query.reply(query.key_expr, codec.seal(frame, address))
        except zenoh.ZError as error:  # the asker has gone
            logger.warning("capture %d could not be sent: %s", self._index, error)
        finally:
            query.drop()  # tells the asker that this was all
