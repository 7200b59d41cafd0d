"""The process image: what the bus exchanges in every rotation, whether the application calls or not."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Protocol

from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import UsageError
from dpstack.text import octets_text
from dpstack.units import NS_PER_S

#: inputs of a slave without watchdog may be this old
UNWATCHED_NS: Final = NS_PER_S


def inputs_limit_ns(watchdog_ns: int, poll_interval_ns: int) -> int:
    """The greatest age of valid inputs in ns: the slave's watchdog time (1 s where it is off, ``watchdog_ns`` 0), and
    never less than two of its poll intervals."""
    return max(watchdog_ns or UNWATCHED_NS, 2 * poll_interval_ns)


def inputs_are_valid(*, exchanging: bool, age_ns: int | None, limit_ns: int) -> bool:
    """The rule for valid inputs, for every driver: the slave is in data exchange (``exchanging``), and its inputs are
    no older than ``limit_ns``. ``age_ns`` None: there never were any."""
    return exchanging and age_ns is not None and age_ns <= limit_ns


class CyclicUnit(Protocol):
    """What runs once a rotation on the bus side for one slave (a drive plugin): pure, quick, no clock of its own.

    An exception out of any of these sets the slave's outputs to their safe values, is told as a fault of kind PLUGIN,
    and leaves the bus alone.
    """

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        """Called just before each Data_Exchange in Operate: the last inputs, the time in ns -> the outputs.

        ``inputs`` are empty while there are no valid ones of this stay in data exchange.
        """

    def lost(self, now: int) -> None:
        """The slave left data exchange, or outputs went to their safe values: what is pending ends with a reason."""

    def safe(self, configured: bytes) -> bytes:
        """The outputs of every way out: ``configured``, unless what the device keeps would change by them."""

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None:
        """An order of the application in plain JSON data; its result is an event that carries ``token``."""

    def take_events(self) -> list[dict[str, object]]:
        """Plain JSON data for the application, oldest first; asked after each of the calls above."""


class SlaveImage:
    """Inputs and outputs of one slave. Assigning ``outputs`` is atomic; it goes out in the next rotation.

    ``inputs`` are the last valid ones (zeros before the first exchange), ``input_time`` when they came, in ns (0: there
    never were any).
    """

    __slots__ = ("_outputs", "input_len", "input_time", "inputs", "latched", "output_len", "unit", "valid")

    def __init__(self, input_len: int, output_len: int, outputs: bytes) -> None:
        self.input_len = input_len
        self.output_len = output_len
        self.inputs = bytes(input_len)
        self.input_time = 0
        #: False while the inputs are not of a slave in data exchange
        self.valid = False
        self.unit: CyclicUnit | None = None
        self._outputs = outputs
        #: the outputs as they were when the round began: those of all slaves are taken over at one moment
        self.latched = outputs

    def latch(self) -> None:
        """A round begins."""
        self.latched = self._outputs

    @property
    def outputs(self) -> bytes:
        """The outputs of the next round in Operate."""
        return self._outputs

    @outputs.setter
    def outputs(self, octets: bytes) -> None:
        octets = bytes(octets)
        if len(octets) != self.output_len:
            raise ValueError(
                f"{octets_text(len(octets))} of outputs given, the slave's configuration has {self.output_len}"
            )
        self._outputs = octets


def image_of(setup: SlaveParams, before: SlaveImage | None = None) -> SlaveImage:
    """The process image of a slave; ``before`` itself where the lengths are the same.

    Raises UsageError where ``before`` has a cyclic unit, which is made for its lengths.
    """
    lengths = (setup.input_len, setup.output_len)
    if before is not None:
        if (before.input_len, before.output_len) == lengths:
            return before
        if before.unit is not None:
            raise UsageError(
                f"{setup.who}: its drive plugin is made for {before.input_len} octets of "
                f"inputs and {before.output_len} of outputs; remove the slave and add it anew for other lengths"
            )
    return SlaveImage(*lengths, setup.safe_outputs if setup.initial is None else setup.initial)
