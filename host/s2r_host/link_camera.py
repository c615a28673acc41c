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

from s2r_host.errors import DamagedAnswerError, PeerUnreachableError
from s2r_host.link_session import answer, ask, open_session, silence_hint
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
        self._session = open_session(endpoint, self._keys, tls, may_come_later=True)

    def capture(self, camera: str = "front", timeout_s: float = 20.0) -> Capture:
        """Ask for one depth frame, taken now.

        Raises:
            PeerUnreachableError: No answer, or the camera reports an error.
            DamagedAnswerError: The frame cannot be read.
            BadViewError: It can, and is no measurement.
        """
        from s2r_host.perception.frames import DepthFrame
        from s2r_host.perception.view_checks import check_centred

        body = self._request(camera, timeout_s)
        if body.error:
            raise PeerUnreachableError(f"{self._who(camera)} has no image: {body.error}")
        try:
            depth_m, colour, K, X_base_camera = arrays_of(body)
        except ValueError as error:
            raise DamagedAnswerError(
                f"{self._who(camera)} sent frame {body.index}, which is damaged: {error}; look at the camera's process"
            ) from error
        frame = DepthFrame(depth_m, K, X_base_camera, colour)
        check_centred(K, depth_m.shape)
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

    def _who(self, camera: str) -> str:
        return f"camera '{camera}' at {self._endpoint}"

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
                return answer(replies[0], pb.Frame, self._who(camera))
            if time.monotonic() > deadline:
                raise PeerUnreachableError(
                    f"no camera '{camera}' answered at {self._endpoint} within {self._connect_timeout_s:g} s; "
                    f"start it with 's2r sim-arm' or correct --camera{silence_hint(self._tls)}"
                )
            time.sleep(0.1)


def arrays_of(body: pb.Frame) -> tuple[np.ndarray, np.ndarray | None, np.ndarray, np.ndarray]:
    """Depth [m] (h, w), colour (h, w, 3) or None, pinhole matrix and pose of a frame.

    Raises:
        ValueError: What it says of its size and what it carries do not go together.
    """
    shape = (body.height, body.width)
    counts = np.frombuffer(_unpacked("depth", body.depth_u16, 2 * shape[0] * shape[1]), "<u2").reshape(shape)
    colour = None
    if body.colour_rgb8:
        data = _unpacked("colour", body.colour_rgb8, 3 * shape[0] * shape[1])
        colour = np.frombuffer(data, np.uint8).reshape(*shape, 3)
    for what, values, needed in (("K", body.K, 9), ("X_base_camera", body.X_base_camera, 16)):
        if len(values) != needed:
            raise ValueError(f"{what} has {len(values)} values instead of {needed}")
    depth_m = (counts * np.float64(body.depth_unit_m)).astype(np.float32)
    return depth_m, colour, np.array(body.K).reshape(3, 3), np.array(body.X_base_camera).reshape(4, 4)


def _unpacked(what: str, packed: bytes, size: int) -> bytes:
    """Exactly so many bytes; never more are unpacked than one beyond."""
    opened = zlib.decompressobj()
    try:
        data = opened.decompress(packed, size + 1)
    except zlib.error as error:
        raise ValueError(f"its {what} cannot be unpacked ({error})") from error
    if len(data) != size or not opened.eof:
        raise ValueError(f"its {what} is not the {size} bytes that its size asks for")
    return data
