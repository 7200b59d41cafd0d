"""The process image: the inputs and outputs of a slave, which the bus exchanges in every rotation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Protocol

from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import UsageError
from dpstack.text import octets_text
from dpstack.units import NS_PER_S

#: the value of a named field of the image
Value = bool | int | float | bytes

#: greatest age of valid inputs of a slave without watchdog
UNWATCHED_NS: Final = NS_PER_S


def inputs_limit_ns(watchdog_ns: int, poll_interval_ns: int) -> int:
    """The greatest age of valid inputs in ns: the slave's watchdog time (1 s if it is off, ``watchdog_ns`` 0), and
    never less than two of its poll intervals."""
    return max(watchdog_ns or UNWATCHED_NS, least_limit_ns(poll_interval_ns))


def least_limit_ns(poll_interval_ns: int) -> int:
    """The least that :func:`inputs_limit_ns` can be."""
    return 2 * poll_interval_ns


def inputs_are_valid(*, exchanging: bool, age_ns: int | None, limit_ns: int) -> bool:
    """The rule for valid inputs, for every driver: the slave is in data exchange (``exchanging``), and its inputs are
    no older than ``limit_ns``. ``age_ns`` None: there never were any."""
    return exchanging and age_ns is not None and age_ns <= limit_ns


#: key of a plugin's event: the name of the drive, of a slave with several drives
DRIVE: Final = "drive"


class CyclicPlugin(Protocol):
    """A drive plugin as the master sees it. The master calls it before each Data_Exchange with its slave.

    Its methods must return quickly, must not block, and get the time as an argument. If a method raises an exception,
    the master sets the slave's outputs to their safe values and reports a fault of kind PLUGIN; the bus goes on.

    A plugin may have a method ``watch(inputs, now)``: the master calls it in Clear, where no outputs of a plugin go
    out, before each Data_Exchange; ``inputs`` as those of :meth:`cyclic`.
    """

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        """Return the outputs of the next Data_Exchange in Operate. ``now`` in ns.

        ``inputs``: the last inputs; empty while there were no valid ones since data exchange began.
        """

    def lost(self, now: int) -> None:
        """The slave left data exchange, or outputs went to their safe values: end pending orders with a reason."""

    def safe(self, configured: bytes) -> bytes:
        """The safe outputs: ``configured``, unless they would change settings that the device keeps."""

    def moved(self, address: int) -> str | None:
        """The slave stopped answering at ``address``: where it is for people, if an order of this plugin has given it
        another address; else None."""

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None:
        """Carry out an order of the application (plain JSON data). Its result is an event with the same ``token``."""

    def take_events(self) -> list[dict[str, object]]:
        """Return and clear the events for the application (plain JSON data), oldest first.

        The master calls it after ``cyclic``, ``lost`` and ``command``.
        """


class SlaveImage:
    """Inputs and outputs of one slave. Assigning ``outputs`` is atomic; it goes out in the next rotation.

    ``inputs`` are the last valid ones (zeros before the first exchange). ``input_time``: the time of their arrival in
    ns, 0 before the first exchange.
    """

    __slots__ = (
        "input_len",
        "input_time",
        "inputs",
        "latched",
        "next_outputs",
        "output_len",
        "plugin",
        "returns",
        "valid",
        "withheld",
    )

    def __init__(self, input_len: int, output_len: int, outputs: bytes) -> None:
        self.input_len = input_len
        self.output_len = output_len
        self.inputs = bytes(input_len)
        self.input_time = 0
        #: False while the slave is not in data exchange, or its inputs cannot be trusted
        self.valid = False
        self.plugin: CyclicPlugin | None = None
        #: the outputs of the next round; :attr:`outputs` sets them
        self.next_outputs = outputs
        #: the outputs as they were when the round began, copied for all slaves at the same moment
        self.latched = outputs
        #: the outputs that the application had set before :meth:`withhold`, until it sets outputs anew
        self.withheld: bytes | None = None
        #: number of calls of :meth:`withhold`
        self.returns = 0

    @property
    def outputs(self) -> bytes:
        """The outputs of the next round in Operate."""
        return self.next_outputs

    @outputs.setter
    def outputs(self, octets: bytes) -> None:
        if type(octets) is not bytes:
            octets = bytes(octets)  # neither a subclass nor a buffer that may change
        if len(octets) != self.output_len:
            raise ValueError(
                f"{octets_text(len(octets))} of outputs given, the slave's configuration has {self.output_len}"
            )
        self.next_outputs = octets

    def withhold(self, safe: bytes) -> None:
        """Make the outputs ``safe``, until the application sets others. :attr:`withheld` keeps those from before."""
        if self.next_outputs != safe:
            self.withheld = self.next_outputs
            self.next_outputs = self.latched = safe
        self.returns += 1


def image_of(setup: SlaveParams, before: SlaveImage | None = None) -> SlaveImage:
    """The process image of a slave; ``before`` itself if the lengths are the same.

    Raises UsageError if ``before`` has a drive plugin, because a plugin is made for one pair of lengths.
    """
    lengths = (setup.input_len, setup.output_len)
    if before is not None:
        if (before.input_len, before.output_len) == lengths:
            return before
        if before.plugin is not None:
            raise UsageError(
                f"{setup.who}: its drive plugin is made for {before.input_len} octets of "
                f"inputs and {before.output_len} of outputs; remove the slave and add it anew for other lengths"
            )
    return SlaveImage(*lengths, setup.safe_outputs if setup.initial is None else setup.initial)
