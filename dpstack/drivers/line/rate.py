"""Baud rate of an open port, which follows its machine; pauses between attempts to open a lost port."""

from __future__ import annotations

from time import monotonic_ns
from typing import Final

from dpstack.errors import BaudError, ConfigError
from dpstack.machine import Machine, RateRefused
from dpstack.ports import Delivery, Port
from dpstack.units import NS_PER_MS, chars_to_ns

#: one more than the octets of the longest telegram
LONGEST: Final = 256


class NoRateError(ConfigError):
    """The port can do none of the baud rates of the machine."""


def follow(port: Port, machine: Machine) -> None:
    """Set the open ``port`` to the baud rate of ``machine``, which chooses another if refused. Raises NoRateError."""
    while machine.baud != port.baud:
        try:
            port.set_baud(machine.baud)
        except BaudError as refusal:
            try:
                machine.command(RateRefused(str(refusal)), monotonic_ns())
            except ConfigError as error:
                raise NoRateError(str(error)) from None


def settle_ns_of(port: Port) -> int:
    """For this time after a change of the rate the port may still deliver octets received before the change.

    An adapter holds octets back for up to 16 ms and hands them over in frames of 1 ms; a hub of ptys is a process that
    may be held up.
    """
    return (20 if port.delivery is Delivery.ADAPTER else 5) * NS_PER_MS


def wire_times(port: Port) -> list[int]:
    """Duration of telegrams in ns by number of octets; 0 on ports where octets take no time."""
    return [chars_to_ns(n, port.baud) if port.paced else 0 for n in range(LONGEST)]


#: Pauses between the attempts to open a lost port in ns: the first, and the longest after doubling.
BACKOFF_NS: Final = (100 * NS_PER_MS, 2_000 * NS_PER_MS)


class ReopenAttempts:
    """Attempts to open a port after one loss."""

    __slots__ = ("_longest", "_pause", "_reason")

    def __init__(self, backoff_ns: tuple[int, int] = BACKOFF_NS) -> None:
        self._pause, self._longest = backoff_ns
        self._reason = ""

    def pause_ns(self) -> int:
        """Pause before the next attempt."""
        pause = self._pause
        self._pause = min(2 * pause, self._longest)
        return pause

    def is_new_reason(self, refusal: str) -> bool:
        """Whether the previous attempt failed for another reason."""
        is_new, self._reason = refusal != self._reason, refusal
        return is_new
