"""Certificates of the OPC UA server: its own, made at the first start, and the judgement of a client's."""

from __future__ import annotations

import ipaddress
import os
import re
from collections.abc import Iterable, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Final
from urllib.parse import quote

from asyncua import ua
from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from dpstack.bridge.opcua.users import read_private
from dpstack.errors import ConfigError

#: a plant computer is often set up once and left; the clients trust this very certificate
_DAYS: Final = 3650
#: days before its end from which on that is reported
_DAYS_BEFORE: Final = 60
_BITS: Final = 2048
_MOST_TRUSTED: Final = 1000
_MOST_OCTETS: Final = 1 << 16


def own_certificate(
    cert: Path, key: Path, *, uri: str, hosts: Iterable[str], now: datetime
) -> tuple[x509.Certificate, rsa.RSAPrivateKey]:
    """The certificate (DER or PEM) and the key (PEM) of the server. If neither file is there, both are made.

    Raises ConfigError if only one is there, they do not belong together, others can read the key, or the
    certificate is not valid at ``now``.
    """
    there = [path for path in (cert, key) if path.exists()]
    if len(there) == 1:
        missing = key if there[0] == cert else cert
        raise ConfigError(
            f"{missing}: is missing beside {there[0]}; put it there, or remove that to have both made anew"
        )
    if not there:
        _make(cert, key, uri, hosts, now)
    text = read_private(key)
    try:
        loaded = serialization.load_pem_private_key(text.encode(), None)
    except (ValueError, TypeError) as error:
        raise ConfigError(f"{key}: is no key in PEM without a password ({type(error).__name__})") from None
    found = read_certificate(cert)
    if not isinstance(loaded, rsa.RSAPrivateKey) or loaded.public_key() != found.public_key():
        raise ConfigError(f"{key}: is not the RSA key of {cert}")
    if now < found.not_valid_before_utc:
        raise ConfigError(
            f"{cert}: is not valid before {_date(found.not_valid_before_utc)}, and this computer has {_date(now)}: set "
            f"its clock, or remove {cert} and {key} to have both made anew"
        )
    if now > found.not_valid_after_utc:
        raise ConfigError(
            f"{cert}: has expired on {_date(found.not_valid_after_utc)}; remove it and {key} to have both made anew, "
            "then let the clients trust the new one"
        )
    if uri not in _uris(found):
        named = ", ".join(_uris(found)) or "no server"
        raise ConfigError(
            f"{cert}: is for {named}, not for {uri}, the name of this server; remove it and {key} to have both made "
            "anew, or change `name`"
        )
    return found, loaded


def own_remarks(found: x509.Certificate, cert: Path, key: Path, host: str, now: datetime) -> list[str]:
    """One line for each fault that a client may see soon: it expires, or is for another computer."""
    remarks = []
    anew = f"remove it and {key} to have both made anew at the next start, then let the clients trust the new one"
    left = found.not_valid_after_utc - now
    if left < timedelta(days=_DAYS_BEFORE):
        when = f"expires on {_date(found.not_valid_after_utc)}, in {left.days} days"
        remarks.append(f"{cert}: {when}: the next start after that fails; {anew}")
    hosts = [str(one.value).lower() for one in _names(found) if isinstance(one, (x509.DNSName, x509.IPAddress))]
    if hosts and host.lower() not in hosts:
        remarks.append(f"{cert}: is for {', '.join(hosts[:5])}, not for {host}: clients may refuse it; {anew}")
    return remarks


def _date(time: datetime) -> str:
    return f"{time:%Y-%m-%d %H:%M} UTC"


def _make(cert: Path, key: Path, uri: str, hosts: Iterable[str], now: datetime) -> None:
    private = rsa.generate_private_key(public_exponent=65537, key_size=_BITS)
    name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, uri.rpartition(":")[2][:64] or "dpstack")])
    names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(uri)]
    for host in dict.fromkeys(hosts):
        try:
            names.append(x509.IPAddress(ipaddress.ip_address(host)))
        except ValueError:
            if host.isascii():  # a certificate has no others
                names.append(x509.DNSName(host))
    usage = x509.KeyUsage(
        digital_signature=True, content_commitment=True, key_encipherment=True, data_encipherment=True,
        key_agreement=False, key_cert_sign=True, crl_sign=False, encipher_only=False, decipher_only=False,
    )  # fmt: skip
    made = (
        x509.CertificateBuilder()
        .subject_name(name)
        .issuer_name(name)
        .public_key(private.public_key())
        .serial_number(x509.random_serial_number())
        # a client whose clock is a little behind
        .not_valid_before(now - timedelta(hours=1))
        .not_valid_after(now + timedelta(days=_DAYS))
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(usage, critical=True)
        .add_extension(x509.ExtendedKeyUsage([ExtendedKeyUsageOID.SERVER_AUTH]), critical=False)
        .add_extension(x509.SubjectAlternativeName(names), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(private.public_key()), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(private.public_key()), critical=False)
        .sign(private, hashes.SHA256())
    )
    text = private.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )
    for path, octets, mode in ((key, text, 0o600), (cert, made.public_bytes(serialization.Encoding.DER), 0o644)):
        try:
            path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            fd = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
            with os.fdopen(fd, "wb") as file:
                file.write(octets)
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise ConfigError(f"{path}: cannot be written: {error.strerror or error}") from None


def read_certificate(path: Path) -> x509.Certificate:
    """A certificate in DER or PEM. Raises ConfigError."""
    try:
        with path.open("rb") as file:
            octets = file.read(_MOST_OCTETS + 1)
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror or error}") from None
    try:
        return (x509.load_pem_x509_certificate if b"-----BEGIN" in octets else x509.load_der_x509_certificate)(octets)
    except ValueError:
        raise ConfigError(f"{path}: is no certificate in DER or PEM") from None


def read_trusted(directory: Path) -> frozenset[bytes]:
    """The certificates of clients in a directory, as DER. Raises ConfigError."""
    try:
        paths = sorted(path for path in directory.iterdir() if path.suffix in (".der", ".pem", ".crt", ".cer"))
    except OSError as error:
        raise ConfigError(f"{directory}: cannot be read: {error.strerror or error}") from None
    if len(paths) > _MOST_TRUSTED:
        raise ConfigError(f"{directory}: more than {_MOST_TRUSTED} certificates")
    return frozenset(read_certificate(path).public_bytes(serialization.Encoding.DER) for path in paths)


def client_fault(der: bytes, trusted: frozenset[bytes] | None, now: datetime) -> int | None:
    """The status code that refuses a client's certificate (Part 4, 6.1.3); None: it is fine. ``trusted`` None: all."""
    try:
        found = x509.load_der_x509_certificate(der)
        key = found.public_key()
    except (ValueError, x509.InvalidVersion, UnsupportedAlgorithm):
        return int(ua.StatusCodes.BadCertificateInvalid)
    if not isinstance(key, rsa.RSAPublicKey) or not 2048 <= key.key_size <= 4096:
        return int(ua.StatusCodes.BadCertificatePolicyCheckFailed)
    if not found.not_valid_before_utc <= now <= found.not_valid_after_utc:
        return int(ua.StatusCodes.BadCertificateTimeInvalid)
    if trusted is not None and der not in trusted:
        return int(ua.StatusCodes.BadCertificateUntrusted)
    return None


def is_of_application(der: bytes, uri: str | None) -> bool:
    """Whether a client's certificate is for the application ``uri`` (Part 4, 5.6.2; Part 6, 6.2.2)."""
    try:
        return uri in _uris(x509.load_der_x509_certificate(der))
    except ValueError:
        return False


def _uris(cert: x509.Certificate) -> list[str]:
    return [str(one.value) for one in _names(cert) if isinstance(one, x509.UniformResourceIdentifier)]


def _names(cert: x509.Certificate) -> list[x509.GeneralName]:
    try:
        return list(cert.extensions.get_extension_for_class(x509.SubjectAlternativeName).value)
    except (x509.ExtensionNotFound, ValueError):
        return []


def application_uri(host: str, name: str) -> str:
    """The ApplicationUri of the server called ``name``: in ASCII, as a certificate has it."""
    return f"urn:{quote(host)}:dpstack:{quote(name)}"


#: reasons to refuse a client, as :func:`client_fault` gives them
CLIENT_FAULTS: Final[Mapping[int, str]] = {
    int(ua.StatusCodes.BadCertificateInvalid): "showed no certificate that can be read",
    int(ua.StatusCodes.BadCertificatePolicyCheckFailed): "showed a certificate without an RSA key of 2048 to 4096 bits",
    int(ua.StatusCodes.BadCertificateTimeInvalid): "showed a certificate that has expired or is not valid yet",
    int(ua.StatusCodes.BadCertificateUntrusted): "showed a certificate that is not in trust_dir",
}


def state_file(name: str) -> Path:
    """A file ``opcua/NAME`` below ``$STATE_DIRECTORY`` (systemd), ``$XDG_STATE_HOME/dpstack`` or
    ``~/.local/state/dpstack``. Characters of a path become ``_``."""
    service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return (Path(service) if service else Path(home) / "dpstack") / "opcua" / re.sub(r"[^\w .-]|^\.", "_", name)


def utc_now() -> datetime:
    return datetime.now(UTC)
