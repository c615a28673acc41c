"""The camera's frames: what cannot be read is refused by name, whatever is wrong with it."""

from __future__ import annotations

import zlib

import numpy as np
import pytest

from s2r_host import link_camera
from s2r_host.errors import DamagedAnswerError
from s2r_host.link_camera import CameraLink
from s2r_host.perception.errors import BadViewError
from s2r_protocol import codec
from s2r_protocol.exits import ExitCode, RefusedError
from s2r_protocol.proto import s2r_pb2 as pb

H, W = 24, 32
K = np.array([[30.0, 0.0, W / 2], [0.0, 30.0, H / 2], [0.0, 0.0, 1.0]])


def frame(**changed) -> pb.Frame:
    """A flat wall one metre away, with something else about it."""
    body = {
        "camera": "front",
        "index": 7,
        "width": W,
        "height": H,
        "depth_u16": zlib.compress(np.full((H, W), 10_000, "<u2").tobytes()),
        "depth_unit_m": 1e-4,
        "colour_rgb8": zlib.compress(bytes(H * W * 3)),
        "K": K.ravel().tolist(),
        "X_base_camera": np.eye(4).ravel().tolist(),
    }
    return pb.Frame(**(body | changed))


def sealed(body) -> bytes:
    return codec.seal(body, codec.Address(sender="camera:1"))


def capture_of(wire, monkeypatch):
    """What a run gets where the camera answers with ``wire``."""
    monkeypatch.setattr(link_camera, "open_session", lambda *_, **__: None)
    monkeypatch.setattr(link_camera, "ask", lambda *_, **__: [wire])
    return CameraLink("tcp/127.0.0.1:7448").capture()


def test_a_whole_frame_is_taken(monkeypatch):
    capture = capture_of(sealed(frame()), monkeypatch)
    assert capture.index == 7
    assert np.allclose(capture.frame.depth_m, 1.0)
    assert capture.frame.colour is not None
    assert capture.frame.colour.shape == (H, W, 3)
    assert capture_of(sealed(frame(colour_rgb8=b"")), monkeypatch).frame.colour is None


@pytest.mark.parametrize(
    ("wire", "said"),
    [
        (sealed(frame())[:-40], "CRC-32"),
        (b"", "shorter than its"),
        (sealed(pb.Verdict()), "expected a s2r.Frame"),
        (sealed(frame(depth_u16=b"nonsense")), "its depth cannot be unpacked"),
        (sealed(frame(depth_u16=frame().depth_u16[:-9])), "its depth is not the 1536 bytes"),
        (sealed(frame(depth_u16=zlib.compress(bytes(10)))), "its depth is not the 1536 bytes"),
        (sealed(frame(depth_u16=zlib.compress(bytes(5_000_000)))), "its depth is not the 1536 bytes"),
        (sealed(frame(colour_rgb8=zlib.compress(bytes(H * W)))), "its colour is not the 2304 bytes"),
        (sealed(frame(width=W + 1)), "its depth is not the 1584 bytes"),
        (sealed(frame(K=[1.0] * 8)), "K has 8 values instead of 9"),
        (sealed(frame(X_base_camera=[])), "X_base_camera has 0 values instead of 16"),
    ],
)
def test_a_damaged_frame_is_refused_by_name(monkeypatch, wire, said):
    with pytest.raises(
        DamagedAnswerError, match=f"camera 'front' at tcp/127.0.0.1:7448 sent .*{said}"
    ) as caught:
        capture_of(wire, monkeypatch)
    assert caught.value.exit_code == ExitCode.REFUSED


@pytest.mark.parametrize(
    "changed",
    [
        {"width": 0, "height": 0, "depth_u16": zlib.compress(b"")},
        {"depth_unit_m": float("nan")},
        {"K": [0.0] * 9},
    ],
)
def test_a_frame_that_is_no_measurement_is_refused(monkeypatch, changed):
    with pytest.raises(RefusedError) as caught:
        capture_of(sealed(frame(colour_rgb8=b"", **changed)), monkeypatch)
    assert isinstance(caught.value, BadViewError)
