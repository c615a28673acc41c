"""The camera on a real Zenoh session, and its process."""

import json
import socket
import threading
import zlib

import numpy as np
import pytest
import zenoh

from s2r_protocol import codec
from s2r_protocol.keys import ArmKeys
from s2r_protocol.proto import s2r_pb2 as pb
from s2r_protocol.session import ListenError
from s2r_sim.camera.camera import View
from s2r_sim.camera.process import CameraProcess
from s2r_sim.camera.service import CameraService
from s2r_sim.camera.snapshot import Snapshot
from s2r_sim.physics import build_world

KEYS = ArmKeys("test", "xmate3pro")
SMALL = View(
    np.linspace(0.5, 1.0, 12, dtype=np.float32).reshape(3, 4),
    np.arange(36, dtype=np.uint8).reshape(3, 4, 3),
    (np.zeros((3, 4), np.uint8), np.zeros((3, 4), np.uint8)),
)


@pytest.fixture
def endpoint():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return f"tcp/127.0.0.1:{probe.getsockname()[1]}"


def ask(endpoint, wire):
    config = zenoh.Config()
    for key, value in (
        ("mode", "peer"),
        ("connect/endpoints", [endpoint]),
        ("listen/endpoints", []),
        ("scouting/multicast/enabled", False),
    ):
        config.insert_json5(key, json.dumps(value))
    with zenoh.open(config) as session:
        replies = list(session.get(KEYS.capture("front"), payload=wire, timeout=30.0))
    assert len(replies) == 1
    return codec.open_body(codec.open_envelope(replies[0].ok.payload.to_bytes()), pb.Frame)


def request(camera="front"):
    return codec.seal(pb.CaptureRequest(camera=camera), codec.Address(sender="test"))


@pytest.fixture
def serve(endpoint):
    services = []

    def start(look):
        services.append(CameraService(endpoint, KEYS, look, np.eye(3), np.eye(4), "c0ffee"))
        return endpoint

    start.services = services
    yield start
    for service in services:
        service.close()


def test_query_is_answered_with_a_frame(serve):
    frame = ask(serve(lambda: SMALL), request())
    depth = np.frombuffer(zlib.decompress(frame.depth_u16), "<u2").reshape(3, 4) * frame.depth_unit_m
    np.testing.assert_allclose(depth, SMALL.depth_m, atol=0.51e-4)
    colour = np.frombuffer(zlib.decompress(frame.colour_rgb8), np.uint8).reshape(3, 4, 3)
    np.testing.assert_array_equal(colour, SMALL.colour)
    assert frame.world_commitment == "c0ffee"
    assert not frame.error


def test_unsealed_query_is_answered_with_the_reason(serve):
    frame = ask(serve(lambda: SMALL), b"hello, camera, are you there?")
    assert "expected b'S2R1'" in frame.error
    assert not frame.depth_u16


def test_other_camera_name_is_answered_with_the_known_one(serve):
    assert "unknown camera 'top'; this process has 'front'" in ask(serve(lambda: SMALL), request("top")).error


def test_failure_in_rendering_is_told_and_survived(serve):
    looks = iter([RuntimeError("lens cap is on"), SMALL])

    def look():
        view = next(looks)
        if isinstance(view, Exception):
            raise view
        return view

    endpoint = serve(look)
    assert "lens cap is on" in ask(endpoint, request()).error
    assert not ask(endpoint, request()).error


def test_an_image_that_cannot_be_packed_is_told_and_survived(serve):
    looks = iter([None, SMALL])
    endpoint = serve(lambda: next(looks))
    assert "capture failed" in ask(endpoint, request()).error
    assert not ask(endpoint, request()).error


def test_an_asker_that_has_gone_is_survived(serve):
    class Gone:
        payload = None
        key_expr = "key"
        dropped = False

        def reply(self, *_):
            raise zenoh.ZError("session closed")

        def drop(self):
            self.dropped = True

    endpoint, gone = serve(lambda: SMALL), Gone()
    serve.services[0]._take(gone)
    assert not ask(endpoint, request()).error
    assert gone.dropped


def test_taken_endpoint_is_refused_with_a_hint(serve):
    endpoint = serve(lambda: SMALL)
    with pytest.raises(ListenError, match="another camera running"):
        CameraService(endpoint, KEYS, lambda: SMALL, np.eye(3), np.eye(4), "c0ffee")


def test_camera_process_sees_the_newest_positions(arm, world, endpoint):
    model = build_world(arm, world)
    snapshot = Snapshot(model.nq)
    qpos = model.qpos0.copy()
    slide = model.joint("object_joint").qposadr[0]
    qpos[slide] = 0.02
    snapshot.write(qpos)
    process = CameraProcess(arm.directory, world, snapshot, endpoint, KEYS)
    try:
        near = ask(endpoint, request())
        qpos[slide] = 0.25
        snapshot.write(qpos)
        far = ask(endpoint, request())
        assert (near.index, far.index) == (1, 2)
        a, b = (np.frombuffer(zlib.decompress(f.depth_u16), "<u2").astype(float) for f in (near, far))
        both = (a > 0) & (b > 0)
        assert np.mean(np.abs(a - b)[both] > 200) > 0.02  # 20 mm
        np.testing.assert_allclose(
            np.reshape(near.X_base_camera, (4, 4)), world.camera.X_base_camera_reported, atol=1e-12
        )
    finally:
        process.close()
    assert not process.alive


def test_snapshot_is_never_torn():
    snapshot = Snapshot(64)
    snapshot.write(np.zeros(64))
    done = threading.Event()

    def write():
        for k in range(20_000):
            snapshot.write(np.full(64, float(k)))
        done.set()

    writer = threading.Thread(target=write)
    writer.start()
    reads = 0
    while not done.is_set():
        values = snapshot.read()
        assert np.all(values == values[0])
        reads += 1
    writer.join()
    assert reads > 0
    assert snapshot.read()[0] == 19_999
