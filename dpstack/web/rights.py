"""Rights of a page: named tokens, the secret of this start, TLS; each is checked before anything listens.

- On this computer alone, without ``--control``: everybody on it may look.
- On this computer with ``--control``: everybody on it may look; orders need the secret of this start, which stands in
  the printed address behind ``#``, where a browser never sends it, or a token.
- With ``--token FILE``: nobody does anything without a token of that file.
"""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import ipaddress
import os
import secrets
import ssl
import stat
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

from dpstack.errors import ConfigError, UsageError
from dpstack.ports.runtime_dir import user_name
from dpstack.text import printable

SHORTEST_TOKEN: Final = 16
_LONGEST_FILE: Final = 1 << 20
_MOST_NAME: Final = 64
#: name in the log for pages with the secret of this start
THIS_COMPUTER: Final = "this computer"
_HOW: Final = (
    'one line for each person, "NAME TOKEN"; a token for instance of '
    "`python3 -c 'import secrets; print(secrets.token_urlsafe())'`"
)
#: seconds before the next token of an address is looked at, by the number of wrong ones before it
_PAUSES_S: Final = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
#: networks whose wrong tokens are remembered, and tokens of one that wait
_MOST_NETWORKS: Final = 1_024
_MOST_WAITING: Final = 4
#: bits of an IPv6 address that one computer does not choose itself
_IPV6_NETWORK: Final = 64
#: verify codes of OpenSSL (X509_V_ERR_...)
_NOT_YET_VALID: Final = 9
_EXPIRED: Final = 10


@dataclass(frozen=True, slots=True)
class Visitor:
    """A page that was let in. ``name``: of its token; None without one. ``control``: it may give orders."""

    name: str | None
    control: bool

    @property
    def who(self) -> str:
        return self.name or THIS_COMPUTER


@dataclass(frozen=True)
class Rights:
    """The rights of one start. ``tokens``: name by token; None if none is needed. ``secret``: that of this start."""

    control: bool = False
    tokens: Mapping[str, str] | None = None
    secret: str | None = None
    pauses: Pauses = field(default_factory=lambda: Pauses())

    def visitor(self, token: str | None) -> Visitor | None:
        """The page with ``token``; None if it is wrong. Takes the same time whatever token it is."""
        if self.tokens is None and not self.control:
            return Visitor(None, False)
        known = dict(self.tokens or {})
        if self.secret is not None:
            known[self.secret] = ""
        given = _digest(token or "")
        found = [name for one, name in known.items() if hmac.compare_digest(_digest(one), given)]
        if token is None:
            return None if self.tokens is not None else Visitor(None, False)
        return Visitor(found[0] or None, self.control) if found else None


def _digest(token: str) -> bytes:
    return hashlib.sha256(token.encode("utf-8", "surrogatepass")).digest()


def network_of(address: str) -> str:
    """The addresses that one computer can have: an IPv4 address alone, the /64 of an IPv6 address."""
    try:
        found = ipaddress.ip_address(address.partition("%")[0])
    except ValueError:
        return address
    if found.version == 6:
        return str(ipaddress.ip_network((found, _IPV6_NETWORK), strict=False))
    return address


class Pauses:
    """Slows down those who try tokens: one token of a network (:func:`network_of`) at a time, and the later the more
    wrong ones it sent."""

    def __init__(self) -> None:
        self._wrong: dict[str, int] = {}
        self._locks: dict[str, asyncio.Lock] = {}
        self._waiting: Counter[str] = Counter()

    async def wait(self, address: str) -> bool:
        """Wait before looking at a token from ``address``. False, at once, if too many of its network wait."""
        network = network_of(address)
        wrong = self._wrong.get(network, 0)
        if not wrong:
            return True
        if self._waiting[network] >= _MOST_WAITING:
            return False
        self._waiting[network] += 1
        try:
            async with self._locks.setdefault(network, asyncio.Lock()):
                await asyncio.sleep(_PAUSES_S[min(wrong, len(_PAUSES_S) - 1)])
        finally:
            self._waiting[network] -= 1
            if not self._waiting[network]:
                del self._waiting[network]
        return True

    def judge(self, address: str, right: bool) -> None:
        network = network_of(address)
        if right:
            self._wrong.pop(network, None)
            self._locks.pop(network, None)
            return
        self._wrong[network] = self._wrong.pop(network, 0) + 1
        while len(self._wrong) > _MOST_NETWORKS:
            oldest = next(iter(self._wrong))
            del self._wrong[oldest]
            self._locks.pop(oldest, None)


def make_rights(*, local: bool, control: bool, tokens: Mapping[str, str] | None, tls: bool) -> Rights:
    """The rights of a start. ``local``: it listens on this computer only; ``tokens``: None without a file of them.

    Raises UsageError if others reach the address and something for it is missing.
    """
    if not local and tokens is None:
        raise UsageError(
            "other computers reach this address: give --token FILE with a token for each person "
            f"({_HOW}, mode 0600), or listen on 127.0.0.1"
        )
    if not local and control and not tls:
        raise UsageError(
            "--control on an address that other computers reach needs --tls CERT KEY: without it everybody on the "
            "network can read the tokens"
        )
    secret = secrets.token_urlsafe(24) if control and tokens is None else None
    return Rights(control, tokens, secret)


def who_may(rights: Rights, *, tls: bool, local: bool) -> str:
    """The rights of a start in a sentence for the person who starts it."""
    if rights.tokens is None:
        orders = "whoever has this whole address" if rights.control else "nobody"
        return f"every user of this computer may look there; {orders} may give orders"
    names = ", ".join(sorted(rights.tokens.values()))
    text = f"these may look there{' and give orders' if rights.control else ''}: {names}"
    if local or tls:
        return text
    return f"{text}; without --tls everybody on the network can read their tokens, and see what they see"


def read_tokens(path: Path) -> dict[str, str]:
    """The tokens of a file with lines ``NAME TOKEN``: name by token. Empty lines and those with ``#`` count as none.

    Raises ConfigError if the file can be read by others or does not belong to this user, if a token is shorter
    than 16 characters, or stands there twice. No message holds a token.
    """
    try:
        with open(path, "rb", opener=_open_unless_waiting) as file:
            _check_private(path, os.fstat(file.fileno()))
            octets = file.read(_LONGEST_FILE + 1)
    except OSError as exc:
        raise ConfigError(f"{path}: cannot be read: {exc.strerror or exc}") from None
    if len(octets) > _LONGEST_FILE:
        raise ConfigError(f"{path}: more than {_LONGEST_FILE} octets: is it the file with the tokens?")
    try:
        lines = octets.decode().splitlines()
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is no text in UTF-8; write {_HOW}") from None
    tokens: dict[str, str] = {}
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        name, *rest = line.split()
        where = f"{path}:{number}"
        if len(rest) != 1:
            raise ConfigError(f"{where}: is not NAME TOKEN; a name has no spaces")
        token = rest[0]
        if len(name) > _MOST_NAME or name != printable(name):
            raise ConfigError(f"{where}: the name has more than {_MOST_NAME} characters, or some that cannot be shown")
        if len(token) < SHORTEST_TOKEN:
            raise ConfigError(
                f"{where}: the token of {name} has {len(token)} characters, a token at least {SHORTEST_TOKEN}"
            )
        if name in tokens.values():
            raise ConfigError(f"{where}: {name} has a token already")
        if token in tokens:
            raise ConfigError(f"{where}: {name} has the same token as {tokens[token]}")
        tokens[token] = name
    if not tokens:
        raise ConfigError(f"{path}: has no token; write {_HOW}")
    return tokens


def _open_unless_waiting(path: str, flags: int) -> int:
    """Open a file; a FIFO without waiting for its writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def _check_private(path: Path, info: os.stat_result) -> None:
    if not stat.S_ISREG(info.st_mode):
        raise ConfigError(f"{path}: is no file")
    if not hasattr(os, "geteuid"):
        return
    if info.st_uid not in (0, os.geteuid()):
        raise ConfigError(f"{path}: belongs to {user_name(info.st_uid)}, who knows its tokens and may change them")
    mode = stat.S_IMODE(info.st_mode)
    if mode & 0o077:
        raise ConfigError(f"{path}: others can read or change it (mode {mode:04o}): `chmod 600 {path}`, and new tokens")


# --- TLS ----------------------------------------------------------------------------------------------------------


def tls_context(cert: Path, key: Path) -> tuple[ssl.SSLContext, frozenset[str]]:
    """The TLS context of the server with ``cert`` (its chain too) and ``key``, PEM files; and the names in ``cert``.

    Raises ConfigError if a file cannot be read, is none of PEM, they do not belong together, the key has a password,
    or ``cert`` is not valid today.
    """
    for path, kind in ((cert, "certificate"), (key, "key")):
        try:
            with path.open("rb") as file:
                mode = os.fstat(file.fileno()).st_mode
                text = file.read(_LONGEST_FILE)
        except OSError as exc:
            raise ConfigError(f"--tls: the {kind} {path} cannot be read: {exc.strerror or exc}") from None
        mark = b"-----BEGIN CERTIFICATE-----" if kind == "certificate" else b"PRIVATE KEY-----"
        if mark not in text:
            raise ConfigError(f"--tls: {path} has no {kind} in PEM; give --tls CERT KEY, in this order")
        if kind == "key" and os.name == "posix" and stat.S_IMODE(mode) & 0o007:
            raise ConfigError(f"--tls: the key {path} can be read by every user: `chmod o= {path}`")
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    asked: list[bool] = []

    def password() -> str:  # else OpenSSL asks on the terminal
        asked.append(True)
        return ""

    try:
        context.load_cert_chain(cert, key, password)
    except ssl.SSLError as error:
        if asked:
            why = f"the key {key} has a password; take it away: `openssl pkey -in {key} -out KEY`"
        elif error.reason == "KEY_VALUES_MISMATCH":
            why = f"the key {key} does not belong to the certificate {cert}"
        else:
            why = f"{cert} and {key} cannot be read as PEM ({error.reason or error})"
        raise ConfigError(f"--tls: {why}") from None
    return context, _check_valid(context, cert)


def _check_valid(context: ssl.SSLContext, cert: Path) -> frozenset[str]:
    """Shake hands with ourselves in memory, ``cert`` the only one that is trusted: OpenSSL judges its dates.

    Returns its names.
    """
    client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.check_hostname = False
    client.verify_flags |= ssl.VERIFY_X509_PARTIAL_CHAIN
    client.load_verify_locations(cert)
    to_server, to_client = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [
        client.wrap_bio(to_client, to_server, server_hostname="localhost"),
        context.wrap_bio(to_server, to_client, server_side=True),
    ]
    try:
        for end in ends * 3:
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
    except ssl.SSLCertVerificationError as error:
        why = {_EXPIRED: "has expired", _NOT_YET_VALID: "is not valid yet: is the clock of this computer right?"}
        raise ConfigError(
            f"--tls: the certificate {cert} {why.get(error.verify_code, f'is refused: {error.verify_message}')}"
        ) from None
    except ssl.SSLError as error:
        raise ConfigError(f"--tls: the certificate {cert} cannot be used ({error.reason or error})") from None
    found = ends[0].getpeercert() or {}
    names = found.get("subjectAltName", ())
    return frozenset(str(name[1]).lower() for name in names if name[0] in ("DNS", "IP Address"))
