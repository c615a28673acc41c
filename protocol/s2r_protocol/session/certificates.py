"""A lab's own certificate authority: made once, kept on one machine, one certificate per role.

X.509 v3 with ECDSA P-256 (RFC 5280, RFC 5480), written with the ``cryptography`` library.
Imported only where certificates are used.
"""

from __future__ import annotations

import datetime
import ipaddress
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from s2r_protocol.exits import UsageError
from s2r_protocol.session.tls import CA_CERTIFICATE, CA_KEY, CertificateError, Role, TlsFiles

CA_DAYS = 3650
ROLE_DAYS = 365
_BACKDATED = datetime.timedelta(minutes=5)  # clocks in a lab differ a little
_HOST_NAME = re.compile(r"(?!-)[A-Za-z0-9_-]{1,63}(\.[A-Za-z0-9_-]{1,63})*")
_ALWAYS_NAMED = ("localhost", "127.0.0.1", "::1")


@dataclass(frozen=True)
class Issued:
    """A certificate that has just been written."""

    name: str
    path: Path
    not_after: datetime.datetime
    names: tuple[str, ...] = ()  # host names and addresses for which it holds


def make_certificates(
    folder: Path, names: Sequence[str] = (), days: int = ROLE_DAYS, now: datetime.datetime | None = None
) -> list[Issued]:
    """Make the lab's authority, or use the one in ``folder``, and write a certificate for each role.

    Args:
        folder: Gets ``ca.pem``, ``ca.key`` and ``<role>.pem``, ``<role>.key``; existing role certificates are renewed.
        names: Host names and addresses under which executor and camera are reached, besides loopback and those in the
            role certificates of ``folder``.
        days: How long the roles' certificates hold.
        now: Time of issue [UTC]; tests pass their own.

    Raises:
        UsageError: ``days`` or a name cannot be used.
        CertificateError: The folder holds half an authority, or cannot be written.
    """
    if not 1 <= days <= CA_DAYS:
        raise UsageError(f"certificates for {days} days: choose 1 to {CA_DAYS}")
    now = now or datetime.datetime.now(datetime.UTC)
    try:
        folder.mkdir(parents=True, exist_ok=True, mode=0o700)
        authority, authority_key, made = _authority(folder, now)
        issued = [made] if made is not None else []
        general = _names([*_names_before(folder), *names])
        for role in Role:
            issued.append(_issue(folder, role, authority, authority_key, general, days, now))
    except OSError as error:
        raise CertificateError(
            f"certificates cannot be written to {folder}: {error.strerror}; name a folder that you may write to"
        ) from error
    return issued


def check_certificate(files: TlsFiles, now: datetime.datetime | None = None) -> datetime.datetime:
    """Whether a role's certificate can be used now; returns when it ends [UTC].

    Raises:
        CertificateError: Expired, not yet valid, of another authority, for another role, or not its key's.
    """

    now = now or datetime.datetime.now(datetime.UTC)
    path = files.ca
    try:
        authority = x509.load_pem_x509_certificate(path.read_bytes())
        path = files.certificate
        certificate = x509.load_pem_x509_certificate(path.read_bytes())
        path = files.key
        key = serialization.load_pem_private_key(path.read_bytes(), None)
    except OSError as error:
        raise CertificateError(f"{files.role}: {path} cannot be read: {error.strerror}") from error
    except (ValueError, TypeError) as error:
        raise CertificateError(
            f"{files.role}: {path} is damaged; copy it once more from where 's2r doctor --make-certs' wrote it"
        ) from error
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature) as error:
        raise CertificateError(
            f"{files.certificate} was not issued by the authority in {files.ca}: take both from one folder"
        ) from error
    if common_name(certificate) != files.role:
        raise CertificateError(
            f"{files.certificate} is for {common_name(certificate)!r}, expected {str(files.role)!r}"
        )
    if key.public_key() != certificate.public_key():
        raise CertificateError(f"{files.key} is not the key of {files.certificate}")
    for which, not_before, not_after in (
        (files.certificate, certificate.not_valid_before_utc, certificate.not_valid_after_utc),
        (files.ca, authority.not_valid_before_utc, authority.not_valid_after_utc),
    ):
        if not not_before <= now <= not_after:
            raise CertificateError(
                f"{which} holds from {not_before:%Y-%m-%d %H:%M} to {not_after:%Y-%m-%d %H:%M} UTC, now it is "
                f"{now:%Y-%m-%d %H:%M}: "
                "renew it with 's2r doctor --make-certs' where the authority's key is, or set the clock"
            )
    return certificate.not_valid_after_utc


def common_name(certificate: x509.Certificate) -> str:
    """The common name, or ""."""

    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def _authority(
    folder: Path, now: datetime.datetime
) -> tuple[x509.Certificate, ec.EllipticCurvePrivateKey, Issued | None]:

    certificate_path, key_path = folder / CA_CERTIFICATE, folder / CA_KEY
    if certificate_path.exists() and key_path.exists():
        path = key_path
        try:
            key = serialization.load_pem_private_key(path.read_bytes(), None)
            path = certificate_path
            certificate = x509.load_pem_x509_certificate(path.read_bytes())
        except (ValueError, TypeError) as error:
            raise CertificateError(
                f"{path} is damaged; put its backup there, or name an empty folder for a new authority, "
                "whose certificates every machine of the lab then needs"
            ) from error
        if not isinstance(key, ec.EllipticCurvePrivateKey) or key.public_key() != certificate.public_key():
            raise CertificateError(f"{key_path} is not the key of {certificate_path}")
        return certificate, key, None
    if certificate_path.exists():
        raise CertificateError(
            f"{folder} holds {CA_CERTIFICATE} without {CA_KEY}: certificates are made where the authority's key is, "
            "or name an empty folder for a new authority"
        )
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"s2r lab {os.urandom(4).hex()}")
    certificate = (
        _builder(name, name, key.public_key(), now, CA_DAYS)
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_usage(authority=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .sign(key, hashes.SHA256())
    )
    _write(certificate_path, key_path, certificate, key)
    return certificate, key, Issued("authority", certificate_path, certificate.not_valid_after_utc)


def _issue(
    folder: Path,
    role: Role,
    authority: x509.Certificate,
    authority_key: ec.EllipticCurvePrivateKey,
    names: list[x509.GeneralName],
    days: int,
    now: datetime.datetime,
) -> Issued:

    key = ec.generate_private_key(ec.SECP256R1())
    # Every role both listens and connects in Zenoh's eyes.
    purposes = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    certificate = (
        _builder(_name(role), authority.subject, key.public_key(), now, days)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_usage(authority=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(
            x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key()), critical=False
        )
        .sign(authority_key, hashes.SHA256())
    )
    path = folder / f"{role}.pem"
    _write(path, folder / f"{role}.key", certificate, key)
    return Issued(role, path, certificate.not_valid_after_utc, tuple(str(name.value) for name in names))


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePublicKey,
    now: datetime.datetime,
    days: int,
) -> x509.CertificateBuilder:

    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - _BACKDATED)
        .not_valid_after(now + datetime.timedelta(days=days))
    )


def _name(common: str) -> x509.Name:

    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common)])


def _names_before(folder: Path) -> list[str]:
    """For what the role certificates in a folder hold; who renews them seldom remembers all of it."""
    found: list[str] = []
    for role in Role:
        try:
            certificate = x509.load_pem_x509_certificate((folder / f"{role}.pem").read_bytes())
            names = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        except (FileNotFoundError, ValueError, x509.ExtensionNotFound):  # none, or none that could be used
            continue
        found += [str(name.value) for name in names if isinstance(name, (x509.DNSName, x509.IPAddress))]
    return found


def _names(extra: Sequence[str]) -> list[x509.GeneralName]:

    names: list[x509.GeneralName] = []
    for text in dict.fromkeys((*_ALWAYS_NAMED, *extra)):
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(text)))
        except ValueError:
            if not _HOST_NAME.fullmatch(text):
                raise UsageError(
                    f"--name {text!r} is neither an address nor a host name; use one as in arm.lab or 10.0.0.7"
                ) from None
            names.append(x509.DNSName(text))
    return names


def _usage(authority: bool) -> x509.KeyUsage:

    return x509.KeyUsage(
        digital_signature=not authority,
        key_cert_sign=authority,
        crl_sign=authority,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _write(
    certificate_path: Path, key_path: Path, certificate: x509.Certificate, key: ec.EllipticCurvePrivateKey
) -> None:

    pem = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    _write_file(key_path, pem, 0o600)
    _write_file(certificate_path, certificate.public_bytes(serialization.Encoding.PEM), 0o644)


def _write_file(path: Path, content: bytes, mode: int) -> None:
    """Beside and renamed: never half a file, never readable by others for a moment."""
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    with os.fdopen(os.open(beside, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode), "wb") as file:
        file.write(content)
    beside.replace(path)
