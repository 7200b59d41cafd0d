"""A device file of a PA device as data: modules, slots, bits, maker's parameters.

The keys are in :mod:`dpstack.devices.keys`. Everything here is checked by the reader.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from msgspec import Struct, field

from dpstack.devices.model import FileFacts
from dpstack.gsd.identifiers import io_lengths

#: kinds of blocks in a slot: function blocks, the display value and the control octet of some makers; "" for a free
#: place
BLOCKS: Final = ("AI", "AO", "DI", "DO", "TOT", "display", "control", "")
#: name of the module of a free place
FREE: Final = "free"
#: index of the first function block of a slot, its block object, since profile 3.0
FIRST_INDEX: Final = 16
#: the codings of the status octet, by the words of a device file
CODINGS: Final = {"classic": "pa-classic", "condensed": "pa-condensed"}


class PaModule(Struct, frozen=True, kw_only=True):
    """A module that a slot may have: identifier octets, and the parts of its data, see
    :mod:`dpstack.devices.pa.layout`."""

    name: str
    block: str
    config: bytes
    outputs: tuple[str, ...] = ()
    inputs: tuple[str, ...] = ()

    @property
    def lengths(self) -> tuple[int, int]:
        """Octets of inputs and outputs."""
        return io_lengths(self.config)


class PaSlot(Struct, frozen=True, kw_only=True):
    """A slot and the function block in it. ``modules``: names of those that it may have; ``module``: of the default."""

    number: int
    block: str
    name: str
    title: str = ""
    unit: str = ""
    modules: tuple[str, ...] = ()
    module: str = FREE
    #: meaning of the value of a discrete block or a control octet
    words: Mapping[int, str] = field(default_factory=dict)
    #: slot and index of the block object over acyclic services
    block_slot: int = 0
    block_index: int = FIRST_INDEX
    source: str = ""


class PaParameter(Struct, frozen=True, kw_only=True):
    """A parameter of the maker's: by block and relative index, or by slot and index. ``type``: as
    :func:`dpstack.pa.datatypes.datatype` names it; ``access``: r or rw."""

    name: str
    block: str = ""
    relative: int | None = None
    slot: int | None = None
    index: int | None = None
    type: str = "u8"
    unit: str = ""
    access: str = "r"
    words: Mapping[int, str] = field(default_factory=dict)
    title: str = ""
    source: str = ""


class PaFile(FileFacts, frozen=True, kw_only=True):
    """The device file of a PA device, read and checked.

    Without slots every slot may have every module: its values are called after the kind of the block, ``ai1``, ``ai2``,
    ``tot1``.
    """

    #: coding of the status octet unless an option says otherwise: "classic" or "condensed"
    coding: str = "classic"
    modules: Mapping[str, PaModule]
    slots: tuple[PaSlot, ...] = ()
    #: bits of CHECKBACK by name, bit 0 of the first octet is 0
    checkback: Mapping[str, int] = field(default_factory=dict)
    #: texts of the bits of DIAGNOSIS_EXTENSION, bit 0 of the first octet is 0
    extension: Mapping[int, str] = field(default_factory=dict)
    #: names of the modules that an ident number of the profile means; empty in a file with slots
    profiles: Mapping[int, tuple[str, ...]] = field(default_factory=dict)
    #: maker's parameters by name
    parameters: Mapping[str, PaParameter] = field(default_factory=dict)
