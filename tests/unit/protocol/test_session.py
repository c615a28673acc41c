"""Addresses that may be used, and a lab's certificates."""

import datetime
import socket
import stat

import pytest
from cryptography import x509

from s2r_protocol.cli.root import main
from s2r_protocol.exits import ExitCode, UsageError
from s2r_protocol.keys import ArmKeys
from s2r_protocol.session import AddressError, CertificateError, Role, TlsFiles, role_held
from s2r_protocol.session.certificates import check_certificate, make_certificates
from s2r_protocol.session.expiry import ExpiryWatch
from s2r_protocol.session.open import ListenError, connect, endpoint_for, listen

NOW = datetime.datetime(2030, 1, 1, tzinfo=datetime.UTC)


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/127.0.0.1:7447",
        "tcp/127.8.0.1:1",
        "tcp/[::1]:7447",
        "tcp/localhost:7447",
        "unixsock-stream//run/s2r",
    ],
)
def test_without_certificates_this_machine_is_reached_as_it_stands(endpoint):
    assert endpoint_for(endpoint, has_tls=False) == endpoint


@pytest.mark.parametrize(
    "endpoint",
    [
        "tcp/0.0.0.0:7447",
        "tcp/[::]:7447",
        "tcp/192.168.1.7:7447",
        "tcp/arm.lab:7447",
        "tcp/127.0.0.1.evil.org:7447",
    ],
)
def test_without_certificates_no_network_is_opened(endpoint):
    with pytest.raises(AddressError, match=r"anybody on that network could command the arm.*--make-certs"):
        endpoint_for(endpoint, has_tls=False)


def test_a_taken_address_is_named_without_the_places_in_zenohs_sources():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(ListenError) as error:
            listen([endpoint], Role.EXECUTOR, ArmKeys("lab", "xmate3pro"))
    assert str(error.value) == (
        f"executor cannot listen on {endpoint}: Address already in use (os error 98). "
        "Is another executor running? Stop it or choose another address with --listen"
    )


def test_a_process_whose_role_does_not_name_it_says_what_it_is(capsys):
    """A relay is a host to the arm, but two of them are no two hosts to who started them."""
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        with pytest.raises(SystemExit) as ended:
            main(["ros2", "--listen", endpoint])
    assert ended.value.code == ExitCode.NOT_READY
    assert f"s2r ros2 cannot listen on {endpoint}: Address already in use" in (
        said := capsys.readouterr().err
    )
    assert "Is another s2r ros2 running? Stop it or choose another address with --listen" in said


@pytest.mark.parametrize("endpoint", ["udp/127.0.0.1:7447", "quic/127.0.0.1:7447", "ws/127.0.0.1:1"])
def test_without_certificates_only_tcp_and_local_sockets_are_spoken(endpoint):
    with pytest.raises(AddressError, match=r"use tcp/127\.0\.0\.1:PORT"):
        endpoint_for(endpoint, has_tls=False)


def test_with_certificates_nothing_is_spoken_in_the_clear():
    assert endpoint_for("tcp/10.0.0.1:7447", has_tls=True) == "tls/10.0.0.1:7447"
    assert endpoint_for("tls/arm.lab:7447", has_tls=True) == "tls/arm.lab:7447"
    with pytest.raises(AddressError, match="use tls/HOST:PORT"):
        endpoint_for("udp/10.0.0.1:7447", has_tls=True)


@pytest.mark.parametrize("endpoint", ["", "tcp", "/x", "127.0.0.1:7447"])
def test_a_malformed_address_is_refused(endpoint):
    with pytest.raises(AddressError):
        endpoint_for(endpoint, has_tls=False)


@pytest.fixture
def lab(tmp_path):
    make_certificates(tmp_path, names=("arm.lab", "10.0.0.7"), days=30, now=NOW)
    return tmp_path


def test_every_role_gets_a_certificate_that_holds_for_the_named_addresses(lab):
    for role in Role:
        ends = check_certificate(TlsFiles.of(lab, role), NOW)
        assert ends == NOW + datetime.timedelta(days=30)
    certificate = x509.load_pem_x509_certificate((lab / "executor.pem").read_bytes())
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert names.get_values_for_type(x509.DNSName) == ["localhost", "arm.lab"]
    assert "10.0.0.7" in map(str, names.get_values_for_type(x509.IPAddress))


def test_keys_are_readable_by_their_owner_only(lab):
    for path in lab.glob("*.key"):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600, path


def test_a_key_for_everybody_and_a_certificate_about_to_end_are_told_once(tmp_path, caplog):
    make_certificates(tmp_path, days=3)
    (tmp_path / "host.key").chmod(0o644)
    for _ in range(2):
        connect("tcp/127.0.0.1:1", Role.HOST, ArmKeys("lab", "xmate3pro"), tmp_path).close()
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == 2
    assert "host.key can be read by every user of this machine" in said[0]
    assert "host.pem ends on" in said[1]


def test_making_again_renews_the_roles_and_keeps_the_authority(lab):
    authority, host = (lab / "ca.pem").read_bytes(), (lab / "host.pem").read_bytes()
    issued = make_certificates(lab, now=NOW + datetime.timedelta(days=29))
    assert (lab / "ca.pem").read_bytes() == authority
    assert (lab / "host.pem").read_bytes() != host
    assert [i.name for i in issued] == [str(role) for role in Role]
    check_certificate(TlsFiles.of(lab, Role.HOST), NOW + datetime.timedelta(days=60))


def names_in(path):
    certificate = x509.load_pem_x509_certificate(path.read_bytes())
    names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    return [str(name.value) for name in names]


def test_making_again_keeps_the_names_and_adds_what_is_named(lab, capsys):
    make_certificates(lab, now=NOW)
    for role in Role:
        assert names_in(lab / f"{role}.pem") == ["localhost", "127.0.0.1", "::1", "arm.lab", "10.0.0.7"]
    with pytest.raises(SystemExit):
        main(["doctor", "--make-certs", str(lab), "--name", "robot", "--json"])
    assert names_in(lab / "executor.pem") == ["localhost", "127.0.0.1", "::1", "arm.lab", "10.0.0.7", "robot"]
    assert "for localhost, 127.0.0.1, ::1, arm.lab, 10.0.0.7, robot" in capsys.readouterr().out
    for role in Role:
        (lab / f"{role}.pem").unlink()
    make_certificates(lab, names=("robot",), now=NOW)
    assert names_in(lab / "executor.pem") == ["localhost", "127.0.0.1", "::1", "robot"]


def test_a_process_that_outlives_its_certificate_tells_it_once_a_day(lab, caplog):
    files, ends = TlsFiles.of(lab, Role.EXECUTOR), NOW + datetime.timedelta(days=30)
    watch = ExpiryWatch(files, ends, NOW)
    said = []
    for hour in range(33 * 24):
        caplog.clear()
        watch.look(NOW + datetime.timedelta(hours=hour))
        said += [(hour / 24, record.levelname, record.getMessage()) for record in caplog.records]
    assert [(day, level) for day, level, _ in said] == [
        *((float(day), "WARNING") for day in range(23, 30)),
        *((float(day), "ERROR") for day in range(30, 33)),
    ]
    assert "executor.pem ends on 2030-01-31 00:00 UTC" in said[0][2]
    assert "executor.pem ended on 2030-01-31 00:00 UTC: nobody reaches this executor" in said[-1][2]


def test_an_authority_without_its_key_makes_nothing(lab):
    (lab / "ca.key").unlink()
    with pytest.raises(CertificateError, match=r"holds ca.pem without ca.key"):
        make_certificates(lab)


def test_certificates_are_refused_before_and_after_their_time(lab):
    files = TlsFiles.of(lab, Role.EXECUTOR)
    for moment in (NOW - datetime.timedelta(hours=1), NOW + datetime.timedelta(days=31)):
        with pytest.raises(
            CertificateError, match=r"executor.pem holds from 2029-12-31 23:55 to 2030-01-31 00:00"
        ):
            check_certificate(files, moment)


def test_a_certificate_of_another_role_authority_or_key_is_named(lab, tmp_path_factory):
    other = tmp_path_factory.mktemp("other")
    make_certificates(other, now=NOW)
    for name, content, said in (
        ("executor.pem", (lab / "host.pem").read_bytes(), "is for 'host', expected 'executor'"),
        ("executor.pem", (other / "executor.pem").read_bytes(), "was not issued by the authority"),
        ("executor.key", (other / "executor.key").read_bytes(), "is not the key of"),
        ("executor.pem", b"rubbish", "executor: .*executor.pem is damaged; copy it once more"),
    ):
        before = (lab / name).read_bytes()
        (lab / name).write_bytes(content)
        with pytest.raises(CertificateError, match=said):
            check_certificate(TlsFiles.of(lab, Role.EXECUTOR), NOW)
        (lab / name).write_bytes(before)


def test_a_missing_file_is_named_with_the_way_to_get_it(tmp_path):
    with pytest.raises(CertificateError, match=r"ca.pem cannot be read \(No such file.*--make-certs"):
        TlsFiles.of(tmp_path, Role.HOST)


def test_an_authority_that_is_missing_is_not_taken_for_another_roles_certificate(lab):
    (lab / "ca.pem").unlink()
    with pytest.raises(CertificateError, match=r"ca.pem cannot be read \(No such file[^)]*\); make it with"):
        TlsFiles.of(lab, Role.HOST)


def test_a_machine_with_the_monitors_certificate_alone_asks_with_it_and_is_told_what_it_lacks(lab):
    wall = lab / "wall"
    wall.mkdir()
    assert role_held(lab, (Role.HOST, Role.MONITOR)) == Role.HOST
    assert role_held(wall, (Role.HOST, Role.MONITOR)) == Role.HOST
    assert role_held(None, (Role.HOST, Role.MONITOR)) == Role.HOST
    for name in ("ca.pem", "monitor.pem", "monitor.key"):
        (wall / name).write_bytes((lab / name).read_bytes())
    assert role_held(wall, (Role.HOST, Role.MONITOR)) == Role.MONITOR
    with pytest.raises(
        CertificateError, match=r"host.pem cannot .*; the certificate of monitor that is there may not"
    ):
        TlsFiles.of(wall, Role.HOST)


@pytest.mark.parametrize("name", ["ca.pem", "ca.key"])
def test_a_damaged_authority_is_named_and_never_replaced(tmp_path, name):
    make_certificates(tmp_path)
    (tmp_path / name).write_text("rubbish")
    with pytest.raises(CertificateError, match=f"{name} is damaged; put its backup there"):
        make_certificates(tmp_path)
    assert (tmp_path / name).read_text() == "rubbish"


def test_odd_wishes_are_refused(tmp_path):
    with pytest.raises(UsageError, match="certificates for 0 days"):
        make_certificates(tmp_path, days=0)
    with pytest.raises(UsageError, match="neither an address nor a host name"):
        make_certificates(tmp_path, names=("ärm.lab",))
