"""The broker of a plant: address, TLS, user and password; the folder for the state of an edge node."""

from __future__ import annotations

import os
import ssl
import stat
from dataclasses import dataclass, field
from hashlib import sha256
from pathlib import Path
from typing import Final
from urllib.parse import quote, urlsplit

from dpstack.errors import ConfigError
from dpstack.text import printable, shortened

_PORTS: Final = {"mqtt": 1883, "mqtts": 8883}
#: characters of the name of a folder, by most file systems
_MOST_FOLDER: Final = 255
#: octets of a password
_MOST_PASSWORD: Final = 4096


@dataclass(frozen=True, slots=True, kw_only=True)
class Broker:
    """``url``: ``mqtt://HOST:PORT``, or with TLS ``mqtts://HOST:PORT``. ``ca``: certificates that the broker's one is
    judged by, empty: those of the system. ``cert``, ``key``: those of this client. All files are PEM.

    Raises ConfigError for a URL or combination that cannot be. No text of it holds the password.
    """

    url: str
    ca: Path | None = None
    cert: Path | None = None
    key: Path | None = None
    user: str = ""
    password: str = field(default="", repr=False)
    keepalive_s: int = 10
    host: str = field(init=False)
    port: int = field(init=False)
    is_tls: bool = field(init=False)

    def __post_init__(self) -> None:
        try:
            parts = urlsplit(self.url)
            host, port = parts.hostname, parts.port
        except ValueError:
            host, port, parts = None, None, urlsplit("")
        if "@" in parts.netloc:
            raise ConfigError("url: user and password have keys of their own (user, password_file); take them out")
        if (
            parts.scheme not in _PORTS
            or not host
            or port == 0
            or parts.path not in ("", "/")
            or parts.query
            or parts.fragment
        ):
            raise ConfigError(
                f"url {shortened(printable(self.url))!r} is no address of a broker; write mqtt://HOST:PORT, or with "
                "TLS mqtts://HOST:PORT"
            )
        object.__setattr__(self, "host", host)
        object.__setattr__(self, "port", port or _PORTS[parts.scheme])
        # not by the text of url: a scheme may be written in capitals
        object.__setattr__(self, "is_tls", parts.scheme == "mqtts")
        if not self.is_tls and (self.ca or self.cert or self.key):
            raise ConfigError("ca, cert and key need TLS; write mqtts:// in url")
        if bool(self.cert) != bool(self.key):
            raise ConfigError("cert and key go together; give both")
        if self.password and not self.user:
            raise ConfigError("a password needs a user; give one")

    @property
    def place(self) -> str:
        return f"{self.host}:{self.port}"

    def tls_context(self) -> ssl.SSLContext | None:
        """Reads the files; None without TLS. The broker's certificate and its name are always judged. Raises
        ConfigError."""
        if not self.is_tls:
            return None
        context = ssl.create_default_context()
        try:
            if self.ca is not None:
                context = ssl.create_default_context(cafile=str(self.ca))
        except (OSError, ssl.SSLError) as error:
            raise ConfigError(f"ca {self.ca}: {_reason(error)}") from None
        if self.cert is not None and self.key is not None:
            try:
                # a key with a password is refused: nobody is there to type it
                context.load_cert_chain(self.cert, self.key, password=lambda: "")
            except (OSError, ssl.SSLError) as error:
                raise ConfigError(f"cert {self.cert}, key {self.key}: {_reason(error)}") from None
        return context


def _reason(error: OSError) -> str:
    text = "it is no PEM file that fits" if isinstance(error, ssl.SSLError) else error.strerror
    return printable(text or str(error))


def read_password(env: str, file: Path | None) -> str:
    """The password from the environment variable ``env``, or from the first line of ``file``; empty without both.

    Raises ConfigError if both are given, if none exists, or if others can read the file. No text of it holds
    the password.
    """
    if env and file is not None:
        raise ConfigError("password_env and password_file are both there; give one of them")
    if env:
        if not os.environ.get(env):
            raise ConfigError(f"password_env: the environment has no variable {printable(env)!r}, or it is empty")
        return os.environ[env]
    if file is None:
        return ""
    try:
        fd = os.open(file, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        with os.fdopen(fd, "rb") as opened:
            info = os.fstat(opened.fileno())
            if not stat.S_ISREG(info.st_mode):
                raise ConfigError(f"password_file {file}: is no file")
            if info.st_uid not in (0, os.geteuid()) or stat.S_IMODE(info.st_mode) & 0o077:
                raise ConfigError(f"password_file {file}: others can read or change it: `chmod 600 {file}`")
            octets = opened.read(_MOST_PASSWORD + 1)
    except OSError as error:
        raise ConfigError(f"password_file {file}: {_reason(error)}") from None
    try:
        password = octets.decode().split("\n")[0].removesuffix("\r")
    except UnicodeDecodeError:
        password = ""
    if not password or len(octets) > _MOST_PASSWORD:
        raise ConfigError(f"password_file {file}: its first line has no password")
    return password


def state_folder(group: str, node: str) -> Path:
    """The folder for the state of an edge node: below ``$STATE_DIRECTORY`` (systemd), ``$XDG_STATE_HOME/dpstack`` or
    ``~/.local/state/dpstack``."""
    service = os.environ.get("STATE_DIRECTORY", "").partition(":")[0]
    home = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    above = Path(service) if service else Path(home) / "dpstack"
    # a dot separates both, and one name may be ".."
    name = ".".join(quote(one, safe=" ").replace(".", "%2E") for one in (group, node))
    if len(name) > _MOST_FOLDER:  # names of 120 octets, as Chinese ones, whose octets have three characters each here
        name = f"{name[: _MOST_FOLDER - 65]}.{sha256(name.encode()).hexdigest()}"
    return above / name
