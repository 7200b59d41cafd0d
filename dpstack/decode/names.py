"""Names and texts of stations: of a user's configuration, or of a GSD file; empty if nobody knows any.

Plain data and functions that a caller hands to the decoder: this room knows neither files nor drives.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from msgspec import Struct, field

from dpstack.decode.fields import Fields
from dpstack.dp.pdu.diag_blocks import FIRST_SLOT

if TYPE_CHECKING:
    from dpstack.dp.field_map import FieldMap
    from dpstack.dp.process_data import Field
    from dpstack.dp.process_image import Value
    from dpstack.gsd.diag_texts import DiagTexts
    from dpstack.gsd.prm import UserPrm
    from dpstack.ppi.addresses import PpiAddress


class DriveWords(Protocol):
    """The process data of a drive, as its plugin reads them. Octets of another length give no fields."""

    def outputs(self, octets: bytes) -> Fields:
        """Parameter channel, control word by its bits, set point."""

    def inputs(self, octets: bytes) -> Fields:
        """Parameter channel, status word by its bits, state, actual values, faults, warnings."""

    def parameter(self, number: int, subindex: int) -> str:
        """The name of a parameter; empty if it has none."""


class ModuleName(NamedTuple):
    """A module by its name ("" for an empty slot) and its identifier octets."""

    #: name; "" for an empty slot
    name: str
    #: identifier octets
    config: bytes


class SlaveNames:
    """Names of one slave. ``ident`` None: any.

    ``modules`` in slot order from ``first_slot`` on; ``drive`` makes the reader of its words, None if it is no drive.
    """

    def __init__(
        self,
        *,
        name: str = "",
        source: str = "",
        ident: int | None = None,
        inputs: FieldMap | None = None,
        outputs: FieldMap | None = None,
        modules: tuple[ModuleName, ...] = (),
        first_slot: int = FIRST_SLOT,
        prm: UserPrm | None = None,
        texts: DiagTexts | None = None,
        drive: Callable[[], DriveWords | None] = lambda: None,
    ) -> None:
        #: name of the slave
        self.name = name
        #: where the names come from, for people
        self.source = source
        #: ident number that they are for; None: any
        self.ident = ident
        #: names of the inputs; None: nothing is named
        self.inputs = inputs
        #: names of the outputs; None: nothing is named
        self.outputs = outputs
        #: modules in slot order, from ``first_slot`` on
        self.modules = modules
        #: number of the first slot
        self.first_slot = first_slot
        #: user parameters
        self.prm = prm
        #: texts of its diagnosis
        self.texts = texts
        #: makes the reader of the drive's words; returns None for a slave that is no drive
        self.drive = drive

    @property
    def config(self) -> bytes:
        """The identifier octets of all modules."""
        return b"".join(module.config for module in self.modules)


class CpuValueName(Protocol):
    """A named value in the memory of an S7-200."""

    @property
    def address(self) -> PpiAddress: ...

    @property
    def field(self) -> Field:
        """Its unit, and the meaning of its numbers."""

    def read(self, octets: bytes) -> Value:
        """The scaled value of the octets of an answer. Raises PduError for another number of octets."""


class CpuNames(NamedTuple):
    """Names of an S7-200 and of values in its memory."""

    #: name of the CPU
    name: str
    #: named values: their addresses, and how they are read
    values: Mapping[str, CpuValueName]


class Names(Struct, frozen=True, eq=False):
    """All names for one bus.

    ``recognise``: names for an ident number and the identifier octets of Chk_Cfg (empty while they are unknown), None
    if no GSD file has them. ``record``: the fields of record 47, of a request (True) or a response, with the names of a
    drive's parameters; empty if the octets are no record.
    """

    #: names of the configured slaves by address
    slaves: Mapping[int, SlaveNames] = field(default_factory=dict)
    recognise: Callable[[int, bytes], SlaveNames | None] = lambda ident, config: None
    record: Callable[[bytes, bool, DriveWords | None], Fields] = lambda octets, request, drive: {}
    #: names of the configured S7-200 CPUs by address
    cpus: Mapping[int, CpuNames] = field(default_factory=dict)


#: nothing is known but the standard
NO_NAMES: Final = Names()
