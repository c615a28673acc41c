"""The camera's side of the wire: a session of its own, one depth frame per question."""

from __future__ import annotations

import os
import time
import zlib
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING

import numpy as np

from s2r_host.errors import PeerUnreachableError
from s2r_host.link_session import ask, open_session, silence_hint
from s2r_protocol import codec
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb

if TYPE_CHECKING:
    from s2r_host.perception.frames import DepthFrame


@dataclass(frozen=True)
class Capture:
    """One depth frame with the camera's own stamp and running number.

    A stand-in's camera also names its sealed world by a salted hash; a real camera leaves ``world_commitment`` empty.
    """

    camera: str
    stamp_ns: int
    index: int
    frame: DepthFrame
    world_commitment: str = ""


class CameraLink:
    """A session with one camera process."""

    def __init__(
        self,
        endpoint: str,
        keys: ArmKeys | None = None,
        connect_timeout_s: float = 15.0,
        tls: Path | None = None,
    ) -> None:
        """Open the session; :meth:`capture` retries until the camera answers.

        Args:
            endpoint: Zenoh endpoint, e.g. ``tcp/127.0.0.1:7448``.
            keys: Cell and arm names.
            connect_timeout_s: How long the first capture retries.
            tls: Folder with the certificates; None when the camera is on this machine.
        """
        self._endpoint = endpoint
        self._keys = keys or ArmKeys()
        self._connect_timeout_s = connect_timeout_s
        self._sender = f"host:{os.getpid()}"
        self._seq = 0
        self._tls = tls
        self._session = open_session(endpoint, self._keys, tls)

    def capture(self, camera: str = "front", timeout_s: float = 20.0) -> Capture:
        """Ask for one depth frame, taken now.

        Raises:
            PeerUnreachableError: No answer, or the camera reports an error.
        """
        from s2r_host.perception.frames import DepthFrame

        body = self._request(camera, timeout_s)
        if body.error:
            raise PeerUnreachableError(f"camera '{camera}' at {self._endpoint} has no image: {body.error}")
        shape = (body.height, body.width)
        counts = np.frombuffer(zlib.decompress(body.depth_u16), "<u2").reshape(shape)
        colour = None
        if body.colour_rgb8:
            colour = np.frombuffer(zlib.decompress(body.colour_rgb8), np.uint8).reshape(*shape, 3)
        frame = DepthFrame(
            depth_m=(counts * np.float64(body.depth_unit_m)).astype(np.float32),
            K=np.array(body.K).reshape(3, 3),
            X_base_camera=np.array(body.X_base_camera).reshape(4, 4),
            colour=colour,
        )
        return Capture(camera, body.stamp_ns, body.index, frame, body.world_commitment)

    def close(self) -> None:
        """Close the session."""
        self._session.close()

    def __enter__(self) -> CameraLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _request(self, camera: str, timeout_s: float) -> pb.Frame:
        deadline = time.monotonic() + self._connect_timeout_s
        key = self._keys.capture(camera)
        while True:
            self._seq += 1
            address = codec.Address(sender=self._sender, seq=self._seq)
            replies = ask(
                self._session, key, codec.seal(pb.CaptureRequest(camera=camera), address), timeout_s
            )
            if replies:
                return codec.open_body(codec.open_envelope(replies[0]), pb.Frame)
            if time.monotonic() > deadline:
                raise PeerUnreachableError(
                    f"no camera '{camera}' answered at {self._endpoint} within {self._connect_timeout_s:g} s; "
                    f"start it with 's2r sim-arm' or correct --camera{silence_hint(self._tls)}"
                )
            time.sleep(0.1)
