"""The stations of a bus as their own telegrams describe them: ident number, modules, DP-V1; fields with their names.

The layout of process data is that of the last Chk_Cfg (or the answer to Get_Cfg). Names come from
:mod:`dpstack.decode.names`: those of the configuration, else those that fit ident number and modules. With
:data:`NO_NAMES` the fields are those of the standard alone.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING, Final, NamedTuple, cast

from dpstack.decode.fields import Fields, dpv1_fields, fields_of, ident_fields, is_dpv1
from dpstack.decode.names import NO_NAMES, DriveWords, Names, SlaveNames
from dpstack.dp.pdu.diag_texts import block_texts, texts_of
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.dpv1.pdu.read_write import PARAMETER_INDEX, Function
from dpstack.errors import ConfigError, GsdError
from dpstack.fdl.telegram import (
    FC_FUNCTION,
    FC_REQUEST,
    SAP_CHK_CFG,
    SAP_GET_CFG,
    SAP_RD_INP,
    SAP_RD_OUTP,
    SAP_SET_PRM,
    SAP_SLAVE_DIAG,
    Req,
    Telegram,
)
from dpstack.gsd.identifiers import parse_identifiers

if TYPE_CHECKING:
    from dpstack.decode.ppi import PpiTalks

_EXCHANGES: Final = frozenset((int(Req.SRD_LOW), int(Req.SRD_HIGH), int(Req.MSRD)))
_NAMELESS: Final = SlaveNames()
#: first octet of a PDU of an S7-200
PDU_OCTET: Final = 0x32
#: identifiers of one Chk_Cfg that are listed in the fields of process data
_MOST_MODULES: Final = 64
#: data units of DP-V1 whose fields are kept: polls repeat them
_KEPT_UNITS: Final = 1024


class _Piece(NamedTuple):
    """The part of a module in the process data of one direction. ``name`` None: the module has none."""

    slot: int
    name: str | None
    begin: int
    end: int


class Station:
    """One station. ``names`` are those that count now, ``drive`` reads its words if it is one."""

    def __init__(self, address: int, names: Names) -> None:
        self._all = names
        self._own = names.slaves.get(address)
        self.names = self._own or _NAMELESS
        self.drive = self.names.drive()
        self._ident: int | None = None
        self._config = b"" if self._own is None else self._own.config
        self._dpv1 = False
        self._user_prm = b""  # of the last Set_Prm, until they are explained
        #: the last octets of outputs and inputs with their fields: most telegrams repeat them
        self._last: list[tuple[bytes, Fields]] = []
        self._pieces: tuple[tuple[_Piece, ...], tuple[_Piece, ...]] = ((), ())  # of outputs, of inputs
        self._lay_out()

    def identified(self, ident: int) -> None:
        """Its ident number was on the bus."""
        if ident != self._ident:
            self._ident = ident
            self._rename()

    def configured(self, config: bytes) -> None:
        """Its identifier octets were on the bus."""
        if config != self._config:
            self._config = config
            self._rename()

    def _rename(self) -> None:
        own, ident = self._own, self._ident
        if own is not None and (own.ident is None or ident is None or own.ident == ident):
            self.names = own
        else:
            found = None if ident is None else self._all.recognise(ident, self._config)
            self.names = found or _NAMELESS
        self.drive = self.names.drive()
        self._lay_out()

    def _lay_out(self) -> None:
        """Assign the octets of the process data to the modules."""
        pieces: tuple[list[_Piece], list[_Piece]] = ([], [])
        ends = [0, 0]
        try:
            identifiers = parse_identifiers(self._config)
        except ConfigError:
            identifiers = []
        places = self._module_places(len(identifiers), [len(one.octets) for one in identifiers])
        for one, (slot, name) in zip(identifiers, places, strict=True):
            for way, size in enumerate((one.outputs, one.inputs)):
                if size:
                    begin, ends[way] = ends[way], ends[way] + size
                    pieces[way].append(_Piece(slot, name, begin, ends[way]))
        self._last = [(b"", {}), (b"", {})]
        several = len(identifiers) > 1 or any(name for _, name in places)
        short = len(identifiers) <= _MOST_MODULES
        self._pieces = (tuple(pieces[0]), tuple(pieces[1])) if several and short else ((), ())

    def _module_places(self, count: int, sizes: list[int]) -> list[tuple[int, str | None]]:
        """Slot and name of the module that each identifier belongs to; a module can have several."""
        first = self.names.first_slot
        if self.names.config != self._config:
            return [(first + number, None) for number in range(count)]
        begins = [sum(sizes[:number]) for number in range(count)]
        found: list[tuple[int, str | None]] = []
        for begin in begins:
            end = 0
            for slot, module in enumerate(self.names.modules, first):
                end += len(module.config)
                if begin < end:
                    found.append((slot, module.name or None))
                    break
        return found

    @property
    def may_be_cpu(self) -> bool:
        """Whether it may be an S7-200: nothing shows that it is a DP slave."""
        return self._own is None and self._ident is None and not self._config

    # --- fields ------------------------------------------------------------------------------------------------------
    def process_data(self, data: bytes, *, inputs: bool) -> Fields:
        """The octets of Data_Exchange by the names of the configuration, by module, and as words of a drive."""
        last, found = self._last[inputs]
        if data != last:
            found = self._process_data(data, inputs)
            self._last[inputs] = data, found
        return found

    def _process_data(self, data: bytes, inputs: bool) -> Fields:
        names = self.names
        found: Fields = {}
        if self._all is NO_NAMES:
            return found
        fields = names.inputs if inputs else names.outputs
        if fields and len(data) == fields.length:
            from dpstack.dp.field_map import as_json  # here, as most buses are explained without names

            found["inputs" if inputs else "outputs"] = as_json(fields.values(data))
        drive = self.drive
        if drive is not None and (words := drive.inputs(data) if inputs else drive.outputs(data)):
            found["drive"] = words
            return found
        pieces = self._pieces[inputs]
        if pieces and pieces[-1].end == len(data):
            found["modules"] = [
                {"slot": slot, "module": name, "data": data[begin:end].hex()} for slot, name, begin, end in pieces
            ]
        return found

    def set_prm(self, data: bytes, found: Fields) -> None:
        """User parameters in the words of the GSD file."""
        self._dpv1 = len(data) > SET_PRM_LEN and bool(data[SET_PRM_LEN] & DPV1_ENABLE)
        if self._ident is None:  # its own diagnosis knows better than its master
            self.identified(int.from_bytes(data[4:6], "big"))
        self._user_prm = data[SET_PRM_LEN:]
        self._add_parameters(found)

    def _add_parameters(self, found: Fields) -> None:
        """The parameters of the last Set_Prm, once it is known to which modules they belong."""
        prm, octets = self.names.prm, self._user_prm
        if prm is None or not octets:
            return
        try:
            read = prm.read(octets)
        except GsdError:
            return
        self._user_prm = b""
        names = [field.parameter.name for field in read]
        if read:
            found["Parameters"] = {
                name if names.count(name) == 1 else field.key: field.parameter.texts.get(field.value, field.value)
                for name, field in zip(names, read, strict=True)
            }

    def configuration(self, data: bytes, found: Fields) -> None:
        """The names of modules, and the parameters in the Set_Prm before, if only the modules give them."""
        self.configured(data)
        self._add_parameters(found)
        if self.names.source:
            found["names_from"] = self.names.source
        entries = found.get("Cfg_Data")
        if isinstance(entries, list) and self._all is not NO_NAMES:
            places = self._module_places(len(entries), [len(entry["identifier"]) // 2 for entry in entries])
            for entry, (slot, name) in zip(entries, places, strict=True):
                entry |= {"slot": slot, "module": name}

    def slave_diag(self, data: bytes, found: Fields) -> None:
        """The texts of the GSD file."""
        diagnosis = Diagnosis.parse(data)
        if diagnosis is None:
            return
        self.identified(diagnosis.ident)
        own = self._own
        if own is not None and own.ident not in (None, diagnosis.ident):
            found["Configured_Ident_Number"] = f"0x{own.ident:04x}"
        texts = self.names.texts
        if diagnosis.ext and texts is not None:
            found["texts"] = list(block_texts(diagnosis, texts, dpv1=self._dpv1))
            for block, entry in zip(diagnosis.blocks, cast("list[Fields]", found["Ext_Diag_Data"]), strict=True):
                if "text" in entry:
                    entry["text"] = "; ".join(texts_of((block,), texts, dpv1=False))


class Stations:
    """The stations of one bus, by what their telegrams say."""

    def __init__(self, names: Names = NO_NAMES) -> None:
        self._names = names
        self._stations: dict[int, Station] = {}
        self._talks: PpiTalks | None = None

    def name_of(self, address: int) -> str:
        """The name in the configuration, empty without one."""
        found = self._names.slaves.get(address) or self._names.cpus.get(address)
        return "" if found is None else found.name

    def fields(self, telegram: Telegram, asked: Telegram | None) -> Fields:
        """The fields of the data unit. ``asked``: the request, of an answer.

        Raises PduError, or ConfigError for identifiers, if the octets are not what their SAP says.
        """
        data, fc = telegram.data, telegram.fc
        if not data:
            return {}
        request = bool(fc & FC_REQUEST)
        address = telegram.da if request else telegram.sa
        station = self._stations.get(address)
        if station is None:
            station = self._stations[address] = Station(address, self._names)
        sap = telegram.dsap if request else telegram.ssap
        if sap is None:
            if telegram.dsap is not None or telegram.ssap is not None:
                return {}
            if data[0] == PDU_OCTET and station.may_be_cpu and (found := self._ppi(telegram, request=request)):
                return found
            if request:
                if fc & FC_FUNCTION in _EXCHANGES:
                    return station.process_data(data, inputs=False)
                return fields_of(telegram)
            if asked is not None and (asked.dsap is not None or asked.ssap is not None):
                return {}
            function = None if asked is None else asked.fc & FC_FUNCTION
            if function == Req.IDENT:
                return ident_fields(data)
            return station.process_data(data, inputs=True) if function is None or function in _EXCHANGES else {}
        if sap in (SAP_RD_INP, SAP_RD_OUTP) and not request:
            return station.process_data(data, inputs=sap == SAP_RD_INP)
        if is_dpv1(telegram):
            found = _dpv1_fields(data, request)
            record = self._record(found, data, request, station.drive)
            return {**found, "Parameter_Access": record} if record else found
        found = fields_of(telegram)
        if sap == SAP_SET_PRM and request:
            station.set_prm(data, found)
        elif (sap == SAP_CHK_CFG and request) or (sap == SAP_GET_CFG and not request):
            station.configuration(data, found)
        elif sap == SAP_SLAVE_DIAG and not request:
            station.slave_diag(data, found)
        return found

    def _ppi(self, telegram: Telegram, *, request: bool) -> Fields | None:
        """The fields of a PDU of an S7-200; None for other data."""
        from dpstack.decode.ppi import PpiTalks, pdu_of  # here, as most buses have no such CPU

        pdu = pdu_of(telegram.data)
        if pdu is None:
            return None
        self._talks = talks = self._talks or PpiTalks(self._names.cpus)
        cpu, master = (telegram.da, telegram.sa) if request else (telegram.sa, telegram.da)
        return talks.fields(pdu, cpu, master, request=request)

    def polls_cpu(self, telegram: Telegram) -> bool:
        """Whether a request without data asks an S7-200 for its answer."""
        talks = self._talks
        return (
            talks is not None
            and not telegram.data
            and telegram.dsap is None
            and telegram.fc & FC_FUNCTION in _EXCHANGES
            and talks.is_asked(telegram.da, telegram.sa)
        )

    def _record(self, found: Fields, data: bytes, request: bool, drive: DriveWords | None) -> Fields | None:
        """Record 47 in a Write or in the answer to a Read."""
        carries = data[0] == (Function.WRITE if request else Function.READ)
        content = found.get("data")
        if carries and found.get("Index") == PARAMETER_INDEX and isinstance(content, str):
            return self._names.record(bytes.fromhex(content), request, drive)
        return None


@lru_cache(_KEPT_UNITS)
def _dpv1_fields(data: bytes, request: bool) -> Fields:
    return dpv1_fields(data, request=request)
