"""Serial drivers of Linux, by class: marks of damaged octets, rates, delay; what each leaves of the Hamming distance.

Every line of the table was seen with the kernel's own driver and an emulated chip (docs/explanation/hardware.md).
"""

from __future__ import annotations

from enum import Enum
from typing import Final

from msgspec import Struct
from msgspec.structs import replace

from dpstack.units import baud_text


class Marks(Enum):
    """How a driver reports an octet with a parity or framing error."""

    OCTET = "octet"  # each at its place
    PACKET = "packet"  # all octets of a USB packet, if one of them is damaged
    MISPLACED = "misplaced"  # beside the octets: the mark may stand on the octets of the next packet
    COUNTED = "counted"  # it only counts them, perhaps after the octets were delivered
    NONE = "none"
    UNKNOWN = "unknown"  # a driver that is not in the table


class KernelDriver(Struct, frozen=True):
    """One driver. ``most``: the highest rate in bit/s that it sends to its chip, whatever reads back; None: it reads
    back the rate that it has sent. ``tells_rate`` False: nobody can know the rate that the adapter makes. ``divides``:
    a UART, whose rate follows from its clock, whatever reads back. ``exception``: to :attr:`protection`."""

    name: str
    marks: Marks
    most: int | None = None
    tells_rate: bool = True
    divides: bool = False
    delay: str = "USB frames of 1 ms"
    exception: str = ""

    @property
    def distance(self) -> int | None:
        """Hamming distance of telegrams with a check sum: 4 with parity, 2 without; None: none can be promised."""
        return _DISTANCES.get(self.marks)

    @property
    def protection(self) -> str:
        """The damage that is noticed, for the engineer of a plant."""
        return _PROTECTION[self.marks].format(driver=self.name) + self.exception

    @property
    def is_weak(self) -> bool:
        """Damaged octets may reach the application as good ones."""
        return self.distance != _DISTANCES[Marks.OCTET]

    @property
    def rates(self) -> str:
        if not self.tells_rate:
            return "accepts every rate; the adapter alone knows which it makes"
        if self.divides:
            return "those that its clock divides to; `dpstack doctor` tries them"
        if self.most is not None:
            return f"up to {baud_text(self.most)}"
        return "those that read back"


_DISTANCES: Final[dict[Marks, int]] = {Marks.OCTET: 4, Marks.PACKET: 4, Marks.NONE: 2}
_PROTECTION: Final[dict[Marks, str]] = {
    Marks.OCTET: "a damaged octet is dropped: up to three wrong bits in a telegram are always noticed (Hamming "
    "distance 4)",
    Marks.PACKET: "a damaged octet is dropped with its USB packet: up to three wrong bits in a telegram are always "
    "noticed (Hamming distance 4)",
    Marks.MISPLACED: "its driver {driver} marks damaged octets, perhaps at the wrong place: two wrong bits in a "
    "telegram may pass as good data (no Hamming distance can be promised)",
    Marks.COUNTED: "its driver {driver} only counts damaged octets, perhaps after it has delivered them: an answer "
    "that was counted in time is repeated, the inputs of a later one are not valid until the next exchange; two wrong "
    "bits may pass as good data for that time (no Hamming distance can be promised)",
    Marks.NONE: "its driver {driver} passes no parity error on: only the check sum protects the data, one wrong bit in "
    "a telegram is noticed, two may pass as good data (Hamming distance 2)",
    Marks.UNKNOWN: "whether its driver {driver} passes parity errors on is not known: two wrong bits in a telegram may "
    "pass as good data (no Hamming distance can be promised)",
}
#: advice for a driver with less than the full Hamming distance
STRONGER: Final = "for a plant take an adapter whose driver marks damaged octets: FTDI (ftdi_sio) or CP2102N (cp210x)"

#: its answer to the driver differs, which leaves the marks off then; nothing else shows it
_COUNTERFEIT: Final = (
    "; not so with a counterfeit CP2102, which only `dpstack doctor --measure` with a second port at --loop shows"
)
#: Linux 6.1; ch341 clamps its divisor at 3 Mbit/s
_TABLE: Final = {
    driver.name: driver
    for driver in (
        KernelDriver("ftdi_sio", Marks.PACKET, delay="latency timer, 16 ms as delivered, 1 ms while dpstack runs"),
        KernelDriver("cp210x", Marks.OCTET, exception=_COUNTERFEIT),
        KernelDriver("ch341-uart", Marks.NONE, most=3_000_000),
        KernelDriver("pl2303", Marks.MISPLACED),
        KernelDriver("cdc_acm", Marks.COUNTED, tells_rate=False),
    )
}
_UART: Final = KernelDriver("", Marks.OCTET, divides=True, delay="none by USB; the FIFO's time-out of a few characters")


def kernel_driver(name: str | None, *, usb: bool) -> KernelDriver:
    """The driver ``name`` (sysfs) of an adapter, or of a UART of the computer (``usb`` False), which marks octets."""
    if name in _TABLE:
        return _TABLE[name]
    if not usb:
        return replace(_UART, name=name or "unknown")
    return KernelDriver(name or "unknown", Marks.UNKNOWN)
