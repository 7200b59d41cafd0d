"""Data model of a GSD file: device, modules, slots, user parameters, diagnosis texts, diagnostics of the file.

Names are the keywords' (PNO order 2.122, GSD specification) in lower case. Lines count from 1. Times are in the file's
units: min_slave_interval in 100 us, response time-outs in 10 ms, MaxTsdr in bit times. Two models that differ in the
lines of their statements only are equal.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from enum import Enum
from typing import Final, NamedTuple, TypeAlias

from msgspec import Struct, field

from dpstack.gsd.dpv1_keywords import DpV1
from dpstack.trace import Severity

#: Allowed values: both ends of each range belong to it, a single value is a range of one.
Ranges: TypeAlias = tuple[tuple[int, int], ...]


def in_ranges(value: int, ranges: Ranges) -> bool:
    """True when ``value`` lies in one of ``ranges``; no ranges allow everything."""
    return not ranges or any(low <= value <= high for low, high in ranges)


def ranges_text(ranges: Ranges) -> str:
    """``ranges`` as text: ``0..3, 5``."""
    return ", ".join(f"{low}..{high}" if low != high else str(low) for low, high in ranges)


class _Placed(Struct, frozen=True):
    """Has a ``line`` in the file, which does not count when two of a class are compared."""

    def __eq__(self, other: object) -> bool:
        return type(self) is type(other) and self._compared() == other._compared()

    def __hash__(self) -> int:
        return hash(self._compared())

    def _compared(self) -> tuple[object, ...]:
        return tuple(getattr(self, name) for name in self.__struct_fields__ if name != "line")


class Diagnostic(Struct, frozen=True):
    """A finding in the file, compared by its place. ``column`` counts from 1; line 0 is the file as a whole."""

    #: line in the file, from 1; 0 is the file as a whole
    line: int
    #: column in the line, from 1
    column: int
    #: error, warning or information
    severity: Severity
    #: the finding for people
    message: str

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Diagnostic) and self._place == other._place

    def __lt__(self, other: Diagnostic) -> bool:
        return self._place < other._place

    def __hash__(self) -> int:
        return hash(self._place)

    @property
    def _place(self) -> tuple[int, int]:
        """Line and column."""
        return self.line, self.column

    @property
    def text(self) -> str:
        """``12:5: warning: ...``."""
        return f"{self.line}:{self.column}: {self.severity.value}: {self.message}"


#: findings of one severity that are listed
_MOST_FINDINGS: Final = 500


class Findings:
    """Collects the diagnostics of one file; beyond 500 of a severity it only counts them."""

    def __init__(self) -> None:
        self._listed: dict[Severity, list[Diagnostic]] = {severity: [] for severity in Severity}
        self._more: Counter[Severity] = Counter()

    def info(self, line: int, message: str, column: int = 1) -> None:
        self._add(Diagnostic(line, column, Severity.INFO, message))

    def warning(self, line: int, message: str, column: int = 1) -> None:
        """Report a violation of the specification or a contradiction; ``message`` says how the file was read."""
        self._add(Diagnostic(line, column, Severity.WARNING, message))

    def error(self, line: int, message: str, column: int = 1) -> None:
        """Report damage of the file."""
        self._add(Diagnostic(line, column, Severity.ERROR, message))

    def _add(self, diagnostic: Diagnostic) -> None:
        listed = self._listed[diagnostic.severity]
        if len(listed) < _MOST_FINDINGS:
            listed.append(diagnostic)
        else:
            self._more[diagnostic.severity] += 1

    def all(self) -> tuple[Diagnostic, ...]:
        """The findings by place, and for each severity with more than 500 the number of the rest."""
        found = [
            Diagnostic(0, 1, severity, f"{more} more findings of this severity are not listed")
            for severity, more in self._more.items()
        ]
        for listed in self._listed.values():
            found += listed
        return tuple(sorted(found))


class Raw(_Placed, frozen=True):
    """A statement that dpstack does not use, unchanged: ``keyword(index) = value``.

    ``block`` is the keyword of the block around it, empty outside of all.
    """

    line: int
    keyword: str
    index: str | None
    value: str
    block: str = ""


class PrmKind(Enum):
    """The data type of a user parameter."""

    BIT = "Bit"
    BIT_AREA = "BitArea"
    UNSIGNED8 = "Unsigned8"
    UNSIGNED16 = "Unsigned16"
    UNSIGNED32 = "Unsigned32"
    SIGNED8 = "Signed8"
    SIGNED16 = "Signed16"
    SIGNED32 = "Signed32"


_SIGNED: Final = frozenset({PrmKind.SIGNED8, PrmKind.SIGNED16, PrmKind.SIGNED32})


class PrmType(Struct, frozen=True):
    """Type and place of a user parameter: bits ``first``..``last`` of ``size`` octets, big-endian."""

    kind: PrmKind
    first: int
    last: int
    size: int

    @property
    def signed(self) -> bool:
        return self.kind in _SIGNED

    @property
    def width(self) -> int:
        return self.last - self.first + 1

    @property
    def limits(self) -> tuple[int, int]:
        """Lowest and highest value the bits can hold."""
        if self.signed:
            return -(1 << self.width - 1), (1 << self.width - 1) - 1
        return 0, (1 << self.width) - 1

    @property
    def text(self) -> str:
        """As the file writes it: ``BitArea(0-3)``, ``Unsigned16``."""
        match self.kind:
            case PrmKind.BIT:
                return f"Bit({self.first})"
            case PrmKind.BIT_AREA:
                return f"BitArea({self.first}-{self.last})"
            case other:
                return str(other.value)


class Parameter(Struct, frozen=True):
    """ExtUserPrmData: one user parameter that devices and modules refer to by ``number``.

    ``allowed`` empty: everything the type can hold. ``texts``: value -> text of its PrmText, empty without one.
    """

    #: number that devices and modules refer to
    number: int
    #: name for people and for the configuration
    name: str
    #: data type and bits
    type: PrmType
    #: default value
    default: int
    #: ranges of allowed values; empty: everything the type can hold
    allowed: Ranges = ()
    #: number of its PrmText; None without one
    text_ref: int | None = None
    texts: Mapping[int, str] = field(default_factory=dict)
    #: Changeable: False: engineering tools show it only
    changeable: bool = True
    #: Visible: False: engineering tools hide it
    visible: bool = True

    def allows(self, value: int) -> bool:
        """Whether ``value`` is one of the allowed ones, and fits the type."""
        return in_ranges(value, (self.type.limits,)) and in_ranges(value, self.allowed)

    @property
    def choices(self) -> dict[int, str]:
        """The texts of allowed values. A PrmText that several parameters share often has more texts."""
        return {value: text for value, text in self.texts.items() if self.allows(value)}


class PrmRef(Struct, frozen=True):
    """Ext_User_Prm_Data_Ref(``offset``) = ``number``."""

    offset: int
    number: int


class PrmConst(Struct, frozen=True):
    """Ext_User_Prm_Data_Const(``offset``) = ``octets``."""

    offset: int
    octets: bytes


class PrmBlock(_Placed, frozen=True):
    """The user parameters of a device or module, in the order of the file.

    ``length``: Ext_Module_Prm_Data_Len of a module; of the device None (as long as its parts reach).
    """

    length: int | None = None
    consts: tuple[PrmConst, ...] = ()
    refs: tuple[PrmRef, ...] = ()
    line: int = 0

    @property
    def present(self) -> bool:
        return self.length is not None or bool(self.consts) or bool(self.refs)


class DiagText(NamedTuple):
    """One text for a diagnosis and its condition.

    Of a bit or an area: the bits ``first``..``last``, counted from 0 at the first octet behind the block's header, have
    the ``value``. Of a channel: the error type is ``value``.
    """

    #: condition of the text: "bit", "not_bit", "area" or "channel"
    kind: str
    #: first bit, counted from 0 at the first octet behind the block's header; None of a channel
    first: int | None
    #: last bit, counted like ``first``; None of a channel
    last: int | None
    #: value of these bits; of a channel the error type
    value: int
    #: text for people
    text: str
    #: further help; empty if the file has none
    help: str


class Diagnosis(Struct, frozen=True):
    """Texts of the diagnosis: of a device, a module or one UnitDiagType (``type``, the first octet after the header).

    ``texts``: those for bits, for bits that are 0, for areas, for channel errors. If the file has a plain and an X_
    text (of DP-V1) for the same condition, the X_ text.
    """

    texts: tuple[DiagText, ...] = ()
    type: int | None = None


class Module(_Placed, frozen=True):
    """One module: a name (no key: several may share it), its number if it has one, identifier octets.

    ``complete`` is False when the file breaks off in it or its EndModule is missing: such a module cannot be used.
    """

    #: name, which several modules may share
    name: str
    #: identifier octets
    config: bytes
    #: number that slots refer to; None without one
    reference: int | None = None
    #: Info_Text for people
    info: str = ""
    #: Preset: the module stands in every configuration if the device has fixed ones
    preset: bool = False
    #: user parameters of the module
    prm: PrmBlock = PrmBlock()
    #: texts of its diagnosis
    diagnosis: Diagnosis = Diagnosis()
    #: statements and blocks that dpstack does not use
    raw: tuple[Raw, ...] = ()
    #: False if the file breaks off in the module or its EndModule is missing: such a module cannot be used
    complete: bool = True
    #: line in the file, from 1
    line: int = 0

    @property
    def f_parameters(self) -> bool:
        """Whether it has parameters of PROFIsafe (F_Ext_User_Prm_Data_Const and similar keywords)."""
        return bool(self.raw) and any(_is_f(raw.keyword) for raw in self.raw)

    @property
    def title(self) -> str:
        """Name and reference number, for messages."""
        return f"{self.name!r}" if self.reference is None else f"{self.name!r} (reference {self.reference})"


class Slot(_Placed, frozen=True):
    """One Slot of SlotDefinition: module references, ``default`` among ``allowed``."""

    #: number of the slot
    number: int
    #: name for people
    name: str
    #: reference of the module that the slot has by default; None without one
    default: int | None
    #: references of the modules that the slot takes
    allowed: Ranges
    #: line in the file, from 1
    line: int = 0


class Speed(Struct, frozen=True):
    """A baud rate in bit/s the device knows, with its MaxTsdr in bit times (None: the file does not say)."""

    #: baud rate in bit/s
    baud: int
    #: MaxTsdr in bit times; None if the file does not say
    max_tsdr: int | None


class Device(Struct, frozen=True):
    """One device. Lengths in octets, None if the file says nothing. ``min_slave_interval`` in 100 us.

    Keywords that dpstack does not use have no field of their own. ``settings``: every ``keyword = value`` of the device
    as written, by keyword in lower case (the last one counts), used or not. ``raw``: statements and blocks that dpstack
    does not use.
    """

    #: Ident_Number
    ident: int | None = None
    #: Vendor_Name
    vendor: str = ""
    #: Model_Name
    model: str = ""
    #: Revision of the device
    revision: str = ""
    #: OrderNumber
    order_number: str = ""
    #: GSD_Revision: 1 to 5
    gsd_revision: int | None = None
    #: Hardware_Release
    hardware_release: str = ""
    #: Software_Release
    software_release: str = ""
    #: Station_Type: 0 slave, 1 master
    station_type: int | None = None
    #: baud rates that the device knows
    speeds: tuple[Speed, ...] = ()
    #: Freeze_Mode_supp
    freeze: bool = False
    #: Sync_Mode_supp
    sync: bool = False
    #: Auto_Baud_supp: the device detects the rate
    auto_baud: bool = False
    #: Set_Slave_Add_supp: a master can change the address
    set_slave_add: bool = False
    #: Fail_Safe: the device takes empty outputs as Clear
    fail_safe: bool = False
    #: Min_Slave_Intervall in 100 us
    min_slave_interval: int | None = None
    #: Modular_Station: the modules are chosen
    modular: bool = False
    #: Max_Module: most modules of a modular station
    max_module: int | None = None
    #: Modul_Offset: number of the first slot
    modul_offset: int | None = None
    #: FixPresetModules: preset modules are in every configuration
    fix_preset_modules: bool = False
    #: Max_Input_Len in octets
    max_input_len: int | None = None
    #: Max_Output_Len in octets
    max_output_len: int | None = None
    #: Max_Data_Len in octets, inputs and outputs together
    max_data_len: int | None = None
    #: Max_Diag_Data_Len in octets, the whole diagnosis
    max_diag_data_len: int | None = None
    #: Max_User_Prm_Data_Len in octets
    max_user_prm_data_len: int | None = None
    #: User_Prm_Data_Len in octets, as the file says
    user_prm_data_len: int | None = None
    #: User_Prm_Data; None if the file has none
    user_prm_data: bytes | None = None
    #: user parameters of the device by name (Ext_User_Prm_Data)
    prm: PrmBlock = PrmBlock()
    #: keywords of DP-V1
    dpv1: DpV1 = DpV1()
    #: Isochron_Mode_supp
    isochronous: bool = False
    #: Isochron_Mode_required: such a device cannot be used here
    isochronous_required: bool = False
    #: Publisher_supp: publishes its inputs by data exchange broadcast
    publisher: bool = False
    #: Subscriber_supp: takes values of publishers by data exchange broadcast
    subscriber: bool = False
    #: DXB_Max_Link_Count: most links of a subscriber
    dxb_max_link_count: int | None = None
    #: DXB_Max_Data_Length: most octets of all its links
    dxb_max_data_length: int | None = None
    #: modules in the order of the file
    modules: tuple[Module, ...] = ()
    #: slots of SlotDefinition; empty if any module may have any slot
    slots: tuple[Slot, ...] = ()
    #: user parameters by number (ExtUserPrmData)
    parameters: Mapping[int, Parameter] = field(default_factory=dict)
    #: texts of the diagnosis of the device
    diagnosis: Diagnosis = Diagnosis()
    #: texts of the diagnosis by type (UnitDiagType)
    diag_types: tuple[Diagnosis, ...] = ()
    settings: Mapping[str, str] = field(default_factory=dict)
    raw: tuple[Raw, ...] = ()

    @property
    def first_slot(self) -> int:
        """The number of the first slot: Modul_Offset, else 1."""
        return 1 if self.modul_offset is None else self.modul_offset

    @property
    def user_prm_data_ignored(self) -> bool:
        """Whether User_Prm_Data does not count: Ext_User_Prm_Data or Max_User_Prm_Data_Len takes its place."""
        return self.prm.present or self.max_user_prm_data_len is not None

    @property
    def f_parameters(self) -> bool:
        """Whether the device itself has parameters of PROFIsafe, beside those of its modules."""
        return any(_is_f(raw.keyword) for raw in self.raw if not raw.block) or any(map(_is_f, self.settings))

    def modules_named(self, name: str) -> tuple[Module, ...]:
        """Every module called ``name``: exactly, otherwise without regard to case and runs of blanks."""
        exact = tuple(module for module in self.modules if module.name == name)
        return exact or tuple(module for module in self.modules if folded(module.name) == folded(name))

    def module_numbered(self, reference: int) -> Module | None:
        """The first module with this reference number."""
        return next((module for module in self.modules if module.reference == reference), None)


class GsdFile(Struct, frozen=True):
    """A parsed file: the model and the findings. ``fatal``: why nothing of the file is usable, else None."""

    #: name of the file
    name: str
    #: device that the file describes
    device: Device
    #: findings in the order of the lines
    diagnostics: tuple[Diagnostic, ...] = ()
    #: encoding that the octets were read with
    encoding: str = "ascii"
    fatal: Diagnostic | None = None


def _is_f(keyword: str) -> bool:
    return keyword[:2].lower() == "f_"


def folded(name: str) -> str:
    """``name`` for comparisons: in one case, runs of blanks as one blank."""
    return " ".join(name.split()).casefold()
