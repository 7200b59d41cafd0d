"""What a caller gives, judged where it is given: another type is refused at once, with what is wanted instead."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Set
from typing import Any

from dpstack.errors import UsageError


def whole(what: str, value: Any, error: type[Exception] = UsageError) -> int:
    """``value`` as it is, where it is a whole number; ranges are judged by whoever knows them. Raises ``error``."""
    if isinstance(value, bool) or not isinstance(value, int):
        raise error(f"{what} = {value!r} is no whole number: give one, 47 or 0x2F for instance")
    return value


def octets(what: str, value: Any, error: type[Exception] = UsageError) -> bytes:
    """``value`` as octets: bytes and their like, or numbers 0..255 in an order. Raises ``error``."""
    if not isinstance(value, (str, int, Mapping, Set)) and isinstance(value, (bytes, bytearray, memoryview, Iterable)):
        try:
            return bytes(value)
        except (TypeError, ValueError):
            pass  # told below
    raise error(f"{what} = {value!r} is no octets: give bytes, b'\\x01\\x02' or bytes.fromhex('01 02') for instance")


def functions(who: str, error: type[Exception] = UsageError, /, **given: object) -> None:
    """Raises ``error`` for what is neither None nor anything that can be called; the first one must be there."""
    for at, (name, value) in enumerate(given.items()):
        if not callable(value) and (value is not None or not at):
            raise error(f"{who}: {name} = {value!r} is no function")
