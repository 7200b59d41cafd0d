"""A drive plugin whose outputs never repeat, for tests that find out where octets came from."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar


@dataclass
class CountingPlugin:
    """Twelve octets of outputs: a number, its complement, the slave's address and ``START_OCTETS``."""

    #: octets that also begin or end telegrams
    START_OCTETS: ClassVar[bytes] = b"\x10\xdc\x16"

    address: int
    number: int = 0

    def next_outputs(self) -> bytes:
        self.number += 1
        count = self.number.to_bytes(4, "big")
        return count + bytes(255 - octet for octet in count) + bytes((self.address,)) + self.START_OCTETS

    def lost(self, now: int) -> None: ...

    def safe(self, configured: bytes) -> bytes:
        return configured

    def moved(self, address: int) -> str | None:
        return None

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None: ...

    def take_events(self) -> list[dict[str, object]]:
        return []
