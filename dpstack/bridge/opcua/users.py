"""Users of the OPC UA server: a private file with names, rights and scrypt hashes; pauses after wrong passwords.

``python -m dpstack.bridge.opcua.users NAME read`` (or ``control``) asks for a password and prints a line of the file.
"""

from __future__ import annotations

import asyncio
import base64
import binascii
import getpass
import hashlib
import hmac
import os
import secrets
import stat
import sys
from collections import OrderedDict
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dpstack.errors import ConfigError
from dpstack.text import printable

#: cost, block size and parallelism of new hashes: 16 MB and some 50 ms a password
_COST, _BLOCK, _PARALLEL = 1 << 14, 8, 1
_LONGEST_FILE: Final = 1 << 20
_MOST_NAME: Final = 64
_LONGEST_PASSWORD: Final = 512
_SHORTEST_PASSWORD: Final = 8
#: seconds before the next password from an address is looked at, by the number of wrong ones before it
_PAUSES_S: Final = (0.0, 0.5, 1.0, 2.0, 4.0, 8.0)
#: addresses whose wrong passwords are remembered; passwords of one address that wait at one time
_MOST_ADDRESSES: Final = 1024
_MOST_WAITING: Final = 4
_HOW: Final = "one line for each user, made by `python -m dpstack.bridge.opcua.users NAME control` (or read)"


@dataclass(frozen=True, slots=True)
class Account:
    """A user. ``control``: may give the orders that ``allow_commands`` lists, and acknowledge alarms."""

    name: str
    control: bool
    hash: str


class Users:
    """The users of a server; :meth:`verify` looks at passwords in a thread, one at a time. Pauses hold up only the
    address that gave the wrong ones."""

    def __init__(self, accounts: dict[str, Account]) -> None:
        self.accounts = accounts
        self._wrong: OrderedDict[str, int] = OrderedDict()
        self._turn = asyncio.Lock()
        #: lock and number of the passwords of an address that wait
        self._waiting: dict[str, tuple[asyncio.Lock, int]] = {}

    async def verify(self, name: str, password: str, address: str) -> Account | None:
        """The account ``name`` if ``password`` is right; None: wrong, or too many passwords of ``address`` wait."""
        turn, waiting = self._waiting.get(address, (asyncio.Lock(), 0))
        if waiting >= _MOST_WAITING or len(password) > _LONGEST_PASSWORD:
            return None
        self._waiting[address] = turn, waiting + 1
        try:
            async with turn:
                wrong = self._wrong.get(address, 0)
                await asyncio.sleep(_PAUSES_S[min(wrong, len(_PAUSES_S) - 1)])
                account = self.accounts.get(name)
                # an unknown name takes the same time
                given = account.hash if account is not None else _NOBODY
                async with self._turn:
                    right = await asyncio.to_thread(is_right, password, given) and account is not None
                self._count(address, right=right)
        finally:
            turn, waiting = self._waiting.pop(address)
            if waiting > 1:
                self._waiting[address] = turn, waiting - 1
        return account if right else None

    def _count(self, address: str, *, right: bool) -> None:
        wrong = self._wrong.pop(address, 0)
        if not right:
            self._wrong[address] = wrong + 1
        while len(self._wrong) > _MOST_ADDRESSES:
            self._wrong.popitem(last=False)


def hash_password(password: str) -> str:
    """``scrypt$COST$BLOCK$PARALLEL$SALT$KEY``, salt and key in base64."""
    salt = secrets.token_bytes(16)
    key = _scrypt(password, salt, _COST, _BLOCK, _PARALLEL)
    texts = (base64.b64encode(part).decode() for part in (salt, key))
    return "$".join(("scrypt", str(_COST), str(_BLOCK), str(_PARALLEL), *texts))


def is_right(password: str, hashed: str) -> bool:
    """Whether ``password`` is that of ``hashed``. Raises ValueError if that is no hash of ours."""
    cost, block, parallel, salt, key = _parts(hashed)
    return hmac.compare_digest(_scrypt(password, salt, cost, block, parallel), key)


def _parts(hashed: str) -> tuple[int, int, int, bytes, bytes]:
    kind, *rest = hashed.split("$")
    if kind != "scrypt" or len(rest) != 5:
        raise ValueError("no hash by scrypt")
    cost, block, parallel = map(int, rest[:3])
    try:
        salt, key = (base64.b64decode(part, validate=True) for part in rest[3:])
    except binascii.Error:
        raise ValueError("no base64") from None
    if not (1 << 12 <= cost <= 1 << 16 and cost & (cost - 1) == 0 and 1 <= block <= 8 and 1 <= parallel <= 4):
        raise ValueError("parameters out of range")
    if len(salt) < 8 or len(key) != 32:
        raise ValueError("salt or key is too short")
    return cost, block, parallel, salt, key


def _scrypt(password: str, salt: bytes, cost: int, block: int, parallel: int) -> bytes:
    octets = password.encode("utf-8", "surrogatepass")
    return hashlib.scrypt(octets, salt=salt, n=cost, r=block, p=parallel, maxmem=1 << 27, dklen=32)


#: the hash of a password that nobody has
_NOBODY: Final = (
    f"scrypt${_COST}${_BLOCK}${_PARALLEL}${base64.b64encode(bytes(16)).decode()}$"
    + base64.b64encode(bytes(32)).decode()
)


def read_users(path: Path) -> dict[str, Account]:
    """The users of a file with lines ``NAME read|control HASH``. Empty lines and those with ``#`` count as none.

    Raises ConfigError if others can read the file, it does not belong to this user, or a line is invalid. No message
    holds a hash.
    """
    try:
        path.stat()
    except FileNotFoundError:
        raise ConfigError(f"users_file {path}: there is no such file; write {_HOW}") from None
    except OSError:
        pass  # the next line says why
    lines = read_private(path).splitlines()
    found: dict[str, Account] = {}
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        where = f"{path}:{number}"
        parts = line.split()
        if len(parts) != 3 or parts[1] not in ("read", "control"):
            raise ConfigError(f"{where}: is not NAME read|control HASH; write {_HOW}")
        name, right, hashed = parts
        if len(name) > _MOST_NAME or name != printable(name):
            raise ConfigError(f"{where}: the name has more than {_MOST_NAME} characters, or some that cannot be shown")
        if name in found:
            raise ConfigError(f"{where}: {name} stands there already")
        try:
            _parts(hashed)
        except ValueError as error:
            raise ConfigError(f"{where}: the hash of {name} cannot be used ({error}); write {_HOW}") from None
        found[name] = Account(name, right == "control", hashed)
    if not found:
        raise ConfigError(f"{path}: has no user; write {_HOW}")
    return found


def read_private(path: Path) -> str:
    """The text of a file that only this user can read. Raises ConfigError."""
    try:
        with open(path, "rb", opener=_open_unless_waiting) as file:
            info = os.fstat(file.fileno())
            if not stat.S_ISREG(info.st_mode):
                raise ConfigError(f"{path}: is no file")
            if hasattr(os, "geteuid") and info.st_uid not in (0, os.geteuid()):
                raise ConfigError(f"{path}: belongs to another user, who may change it")
            if os.name == "posix" and stat.S_IMODE(info.st_mode) & 0o077:
                raise ConfigError(f"{path}: others can read or change it: `chmod 600 {path}`")
            octets = file.read(_LONGEST_FILE + 1)
    except OSError as exc:
        raise ConfigError(f"{path}: cannot be read: {exc.strerror or exc}") from None
    if len(octets) > _LONGEST_FILE:
        raise ConfigError(f"{path}: more than {_LONGEST_FILE} octets")
    try:
        return octets.decode()
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: is no text in UTF-8") from None


def _open_unless_waiting(path: str, flags: int) -> int:
    """Open a file; a FIFO without waiting for its writer."""
    return os.open(path, flags | getattr(os, "O_NONBLOCK", 0))


def main(arguments: list[str]) -> int:
    if len(arguments) != 2 or arguments[1] not in ("read", "control") or len(arguments[0].split()) != 1:
        print("usage: python -m dpstack.bridge.opcua.users NAME read|control", file=sys.stderr)
        return 2
    try:
        password = getpass.getpass("password: ") if sys.stdin.isatty() else sys.stdin.readline().rstrip("\n")
    except (KeyboardInterrupt, EOFError):
        print("\nno password was typed: there is no line for this user", file=sys.stderr)
        return 130
    if not _SHORTEST_PASSWORD <= len(password) <= _LONGEST_PASSWORD:
        print(f"a password has {_SHORTEST_PASSWORD} to {_LONGEST_PASSWORD} characters", file=sys.stderr)
        return 2
    print(arguments[0], arguments[1], hash_password(password))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
