"""What a program hands to acyclic services, checked: a wrong one says at once what is wanted, before it is sent."""

from __future__ import annotations

import math

from dpstack.errors import UsageError
from dpstack.units import s_to_ns


def time_of(seconds: float, what: str = "timeout") -> int:
    """A time that a user gives for a service, in ns. Raises UsageError for what is none."""
    if not isinstance(seconds, (int, float)) or not math.isfinite(seconds) or seconds < 0:
        raise UsageError(f"{what} = {seconds!r} is no time for a service: seconds are wanted, 0 or more")
    return s_to_ns(seconds)


def octets_of(data: object, what: str = "data") -> bytes:
    """Octets that a user gives. Raises UsageError for what is none: ``bytes(3)`` would be three zeros."""
    if isinstance(data, (bytes, bytearray, memoryview)):
        return bytes(data)
    if isinstance(data, (list, tuple)):
        try:
            return bytes(data)
        except (TypeError, ValueError):
            pass
    wanted = {
        int: "b'\\x05', or (5).to_bytes(2, 'big') for a word",
        str: "bytes.fromhex('00FF'), or 'text'.encode()",
    }.get(type(data), "b'\\x00\\xff'")
    raise UsageError(f"{what} = {data!r} are no octets: give bytes, for instance {wanted}")


def whole(number: object, name: str, low: int, high: int) -> int:
    """A whole number from ``low`` to ``high``. Raises UsageError for anything else."""
    if not isinstance(number, int) or not low <= number <= high:
        raise UsageError(f"{name} = {number!r}: a whole number {low}..{high} is wanted")
    return number
