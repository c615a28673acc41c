"""Who gets through to the arm: real sessions with right, wrong, expired and missing certificates."""

from __future__ import annotations

import datetime
import json
import socket
import threading
import time
from types import SimpleNamespace

import pytest
import zenoh

from s2r_protocol.keys import ArmKeys
from s2r_protocol.session import CertificateError, Role, connect, listen
from s2r_protocol.session.access import access_control
from s2r_protocol.session.certificates import make_certificates

KEYS = ArmKeys("lab", "xmate3pro")
OBSERVATION = "0/lab/xmate3pro/joint_states/JointState_/hash"
COMMANDS = (KEYS.lease, KEYS.plan, KEYS.control)
READABLE = (KEYS.hello, KEYS.recording)
SILENCE_S = 1.0  # how long a query that nobody may answer is waited for


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lab")
    make_certificates(folder)
    return folder


def free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@pytest.fixture(scope="module")
def executor(lab):
    """Everything the executor offers, and a note of everything that reached it."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    reached: list[str] = []
    session = listen([endpoint], Role.EXECUTOR, KEYS, lab)

    def answer(query: zenoh.Query) -> None:
        reached.append(str(query.key_expr))
        with query:
            query.reply(query.key_expr, b"yes")

    for key in (*READABLE, *COMMANDS, "lab/xmate3pro/secret"):
        session.declare_queryable(key, answer)
    session.declare_subscriber(KEYS.heartbeat, lambda sample: reached.append(str(sample.key_expr)))
    session.declare_subscriber(
        "**", lambda sample: reached.append(str(sample.key_expr)), allowed_origin=zenoh.Locality.REMOTE
    )
    token = session.liveliness().declare_token("@ros2_lv/0/abc/0/0/NN")
    ended = threading.Event()

    def publish() -> None:
        while not ended.wait(0.01):
            session.put(OBSERVATION, b"state")
            session.put("lab/xmate3pro/unlisted", b"secret")

    publisher = threading.Thread(target=publish, daemon=True)
    publisher.start()
    yield SimpleNamespace(endpoint=endpoint, reached=reached, session=session)
    ended.set()
    publisher.join()
    token.undeclare()
    session.close()


def replies(session: zenoh.Session, key: str, timeout_s: float = 10.0) -> list[bytes]:
    return [r.ok.payload.to_bytes() for r in session.get(key, timeout=timeout_s) if r.ok is not None]


def first_reply(session: zenoh.Session, key: str) -> list[bytes]:
    """Tries until the link is up: opening returns before it is."""
    deadline = time.monotonic() + 300
    while not (got := replies(session, key)) and time.monotonic() < deadline:
        time.sleep(0.05)
    return got


def until(condition, timeout_s: float = 300.0) -> bool:
    deadline = time.monotonic() + timeout_s
    while not condition():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.01)
    return True


def unchecked(endpoint: str, tls: dict[str, str], **more: object) -> zenoh.Session:
    """A stranger's session: none of our own checks, no access control of its own."""
    config = zenoh.Config()
    settings = {
        "mode": "peer",
        "connect/endpoints": [endpoint],
        "connect/timeout_ms": 0,
        "connect/exit_on_failure": False,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 100, "period_increase_factor": 1},
        "listen/endpoints": [],
        "scouting/multicast/enabled": False,
        "transport/link/tls": tls,
        **more,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    return zenoh.open(config)


def files(folder, role: str, ca=None) -> dict[str, object]:
    return {
        "root_ca_certificate": str(ca or folder / "ca.pem"),
        "connect_private_key": str(folder / f"{role}.key"),
        "connect_certificate": str(folder / f"{role}.pem"),
        "enable_mtls": True,
    }


def reaches_nothing(executor, session: zenoh.Session) -> bool:
    """Neither asking, putting, listening nor looking for presence gets anything through."""
    seen: list[zenoh.Sample] = []
    before = len(executor.reached)
    with session:
        session.declare_subscriber("**", seen.append, allowed_origin=zenoh.Locality.REMOTE)
        deadline = time.monotonic() + 2 * SILENCE_S
        answers = []
        while time.monotonic() < deadline:
            for key in (*READABLE, *COMMANDS):
                answers += replies(session, key, SILENCE_S)
            session.put(KEYS.heartbeat, b"alive")
            session.put(KEYS.plan, b"move")
            answers += [r for r in session.liveliness().get("**", timeout=0.2) if r.ok is not None]
    return not answers and not seen and len(executor.reached) == before


def test_a_host_with_the_right_certificate_asks_commands_and_listens(executor, lab):
    seen: list[str] = []
    with connect(executor.endpoint, Role.HOST, KEYS, lab) as session:
        session.declare_subscriber(OBSERVATION, lambda sample: seen.append(str(sample.key_expr)))
        for key in (*READABLE, *COMMANDS):
            assert first_reply(session, key) == [b"yes"], key
        assert until(lambda: seen)
        assert until(lambda: session.put(KEYS.heartbeat, b"1") or KEYS.heartbeat in executor.reached)
        assert [r for r in session.liveliness().get("@ros2_lv/**", timeout=5.0) if r.ok is not None]


def test_a_key_that_is_not_listed_reaches_nobody_even_with_the_right_certificate(executor, lab):
    seen: list[str] = []
    with unchecked(executor.endpoint.replace("tcp", "tls"), files(lab, "host")) as session:
        session.declare_subscriber("lab/xmate3pro/unlisted", lambda sample: seen.append("leak"))
        assert first_reply(session, KEYS.hello) == [b"yes"]
        executor.reached.clear()
        assert replies(session, "lab/xmate3pro/secret", SILENCE_S) == []
        session.put("lab/xmate3pro/secret", b"x")
        session.put(OBSERVATION, b"a forged state")
        assert replies(session, "**", SILENCE_S) == []
        assert first_reply(session, KEYS.hello) == [
            b"yes"
        ]  # what was sent before has arrived, if it ever does
    assert set(executor.reached) == {KEYS.hello}
    assert not seen


@pytest.mark.parametrize("own_rules", [True, False])
def test_a_monitor_reads_and_cannot_command(executor, lab, own_rules):
    def opened() -> zenoh.Session:
        if own_rules:
            return connect(executor.endpoint, Role.MONITOR, KEYS, lab)
        return unchecked(executor.endpoint.replace("tcp", "tls"), files(lab, "monitor"))

    seen: list[str] = []
    with opened() as session:
        session.declare_subscriber(OBSERVATION, lambda sample: seen.append(str(sample.key_expr)))
        for key in READABLE:
            assert first_reply(session, key) == [b"yes"], key
        assert until(lambda: seen)
        executor.reached.clear()
        for key in COMMANDS:
            assert replies(session, key, SILENCE_S) == [], key
        session.put(KEYS.heartbeat, b"alive")
        assert first_reply(session, KEYS.hello) == [b"yes"]
    assert set(executor.reached) == {KEYS.hello}


def test_a_camera_certificate_has_no_business_with_the_executor(executor, lab):
    session = unchecked(executor.endpoint.replace("tcp", "tls"), files(lab, "camera"))
    assert reaches_nothing(executor, session)


def test_a_certificate_of_another_authority_gets_nothing(executor, lab, tmp_path):
    make_certificates(tmp_path)
    stranger = unchecked(executor.endpoint.replace("tcp", "tls"), files(tmp_path, "host", lab / "ca.pem"))
    assert reaches_nothing(executor, stranger)


def test_an_expired_certificate_gets_nothing(executor, lab, tmp_path):
    for name in ("ca.pem", "ca.key"):
        (tmp_path / name).write_bytes((lab / name).read_bytes())
    long_ago = datetime.datetime.now(datetime.UTC) - datetime.timedelta(days=40)
    make_certificates(tmp_path, days=30, now=long_ago)
    assert reaches_nothing(
        executor, unchecked(executor.endpoint.replace("tcp", "tls"), files(tmp_path, "host"))
    )
    with pytest.raises(CertificateError, match=r"host.pem holds from .* renew it"):
        connect(executor.endpoint, Role.HOST, KEYS, tmp_path)


def test_no_certificate_gets_nothing(executor, lab):
    bare = {"root_ca_certificate": str(lab / "ca.pem")}
    assert reaches_nothing(executor, unchecked(executor.endpoint.replace("tcp", "tls"), bare))
    assert reaches_nothing(executor, unchecked(executor.endpoint, bare))  # plain TCP


def test_a_host_does_not_talk_to_an_executor_of_another_lab(lab, tmp_path):
    """A stranger that listens where the executor should be is not believed."""
    make_certificates(tmp_path)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    with listen([endpoint], Role.EXECUTOR, KEYS, tmp_path) as stranger:
        asked = []
        stranger.declare_queryable(KEYS.hello, lambda query: asked.append(query.drop()))
        with connect(endpoint, Role.HOST, KEYS, lab) as host:
            assert replies(host, KEYS.hello, SILENCE_S) == []
    assert not asked


def test_a_camera_cannot_pass_for_the_executor(lab):
    """A stolen camera certificate must not be able to answer hello or state."""
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    impostor_config = {
        "listen_private_key": str(lab / "camera.key"),
        "listen_certificate": str(lab / "camera.pem"),
        "root_ca_certificate": str(lab / "ca.pem"),
        "enable_mtls": True,
    }
    listening = {"listen/endpoints": [endpoint.replace("tcp", "tls")], "connect/endpoints": []}
    with unchecked("", impostor_config, **listening) as impostor:
        asked, seen = [], []
        impostor.declare_queryable(KEYS.hello, lambda query: asked.append(query.reply(KEYS.hello, b"me")))
        impostor.declare_queryable(KEYS.capture(), lambda query: query.reply(KEYS.capture(), b"depth"))
        with connect(endpoint, Role.HOST, KEYS, lab) as host:
            host.declare_subscriber(OBSERVATION, seen.append)
            assert first_reply(host, KEYS.capture()) == [b"depth"]  # it is the camera, as such it may answer
            assert replies(host, KEYS.hello, SILENCE_S) == []
            impostor.put(OBSERVATION, b"forged")
            assert first_reply(host, KEYS.capture()) == [b"depth"]
    assert not asked
    assert not seen


def test_every_role_has_rules_for_what_it_does_and_for_nothing_else():
    monitor = access_control(Role.MONITOR, KEYS)
    assert monitor["default_permission"] == "deny"
    may_ask = {key for rule in monitor["rules"] if "query" in rule["messages"] for key in rule["key_exprs"]}
    assert may_ask == {KEYS.hello, KEYS.recording, KEYS.capture("*")}
    executor = access_control(Role.EXECUTOR, KEYS)
    subjects_of = {policy["rules"][0]: set(policy["subjects"]) for policy in executor["policies"]}
    for name in ("lease", "plan", "control", "heartbeat"):
        assert subjects_of[f"{name}, ingress"] == {"host"}
    assert not any("camera" in subjects for subjects in subjects_of.values())
