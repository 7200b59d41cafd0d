"""The state of a port: its rate follows what its machine wants, and a lost one is opened again.

For that: the pauses between the attempts, and which refusal is worth telling.
"""

from __future__ import annotations

from time import monotonic_ns
from typing import Final

from dpstack.errors import BaudError, ConfigError
from dpstack.machine import Machine, RateRefused
from dpstack.ports import Delivery, Port
from dpstack.units import NS_PER_MS, chars_to_ns

_LONGEST: Final = 256


class NoRateError(ConfigError):
    """The port can do none of the rates that the machine wants."""


def follow(port: Port, machine: Machine) -> None:
    """Set the open ``port`` to the rate that ``machine`` wants; one refused is told to it. Raises NoRateError."""
    while machine.baud != port.baud:
        try:
            port.set_baud(machine.baud)
        except BaudError as refusal:
            try:
                machine.command(RateRefused(str(refusal)), monotonic_ns())
            except ConfigError as error:
                raise NoRateError(str(error)) from None


def settle_ns_of(port: Port) -> int:
    """What arrives so soon after a change of the rate may have been received before it.

    An adapter holds octets back for up to 16 ms and hands them over in frames of 1 ms; a hub of ptys is a process that
    may be held up.
    """
    return (20 if port.delivery is Delivery.ADAPTER else 5) * NS_PER_MS


def wire_times(port: Port) -> list[int]:
    """What a telegram of so many octets takes to leave, in ns; nothing where no wire gives octets their time."""
    return [chars_to_ns(n, port.baud) if port.paced else 0 for n in range(_LONGEST)]


#: Pauses between the attempts to open a lost port in ns: the first, and the longest after doubling.
BACKOFF_NS: Final = (100 * NS_PER_MS, 2_000 * NS_PER_MS)


class Attempts:
    """The attempts that follow one loss."""

    __slots__ = ("_longest", "_pause", "_told")

    def __init__(self, backoff_ns: tuple[int, int] = BACKOFF_NS) -> None:
        self._pause, self._longest = backoff_ns
        self._told = ""

    def pause_ns(self) -> int:
        """How long to wait before the next attempt."""
        pause = self._pause
        self._pause = min(2 * pause, self._longest)
        return pause

    def is_news(self, refusal: str) -> bool:
        """Whether the attempt before failed for another reason."""
        news, self._told = refusal != self._told, refusal
        return news
