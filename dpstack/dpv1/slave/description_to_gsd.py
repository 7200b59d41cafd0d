"""The GSD file of a slave by its description, so that the engineering tool of a PLC knows the slave.

A GSD file cannot say everything that a :class:`SlaveDescription` says: :func:`as_gsd_file` is what remains of one, and
what was changed. :func:`gsd_text` writes that, and reading it (:func:`slave_description`) gives the same again.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Final

from dpstack.dp.pdu.alarm_blocks import HEAD
from dpstack.dp.pdu.diagnosis import FIXED_LEN
from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE, FAIL_SAFE, PRM_STRUCTURE
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.slave_params import INTERVAL_UNIT
from dpstack.dpv1.slave.description import SlaveDescription, SlaveModule, SlaveParameter
from dpstack.dpv1.slave.description_from_gsd import EMPTY_SLOT
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.blocks import prm_type_of
from dpstack.gsd.dpv1_keywords import ALARM_KEYWORDS
from dpstack.gsd.identifiers import MAX_USER_PRM, io_lengths
from dpstack.gsd.model import DiagText, in_ranges, ranges_text
from dpstack.gsd.prm import write_bits
from dpstack.gsd.settings import RATES
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import octets_text, shortened

#: MaxTsdr in bit times if the description says none: the standard's values for all slaves
_MAX_TSDR: Final = {500_000: 100, 1_500_000: 150, 3_000_000: 250, 6_000_000: 450, 12_000_000: 800}
_MAX_TSDR_BELOW: Final = 60
#: the spelling of a rate in keywords
_RATE_WORDS: Final = {baud: word.replace("m", "M") for word, baud in RATES.items()}
#: characters of Vendor_Name, Model_Name, Revision and of names of modules
_LONGEST_NAME: Final = 32
_LONGEST_TEXT: Final = 200
_UNKNOWN_VENDOR: Final = "unknown"
_FIRST_REVISION: Final = "V1.0"
_ENCODING: Final = "cp1252"
#: Response_Timeout in units of 10 ms
_RESPONSE: Final = 100
_DIAG_ORDER: Final = ("bit", "not_bit", "area", "channel")


def as_gsd_file(slave: SlaveDescription) -> tuple[SlaveDescription, tuple[str, ...]]:
    """(the description as a GSD file can say it, remarks about what was changed that matters).

    Raises ConfigError for a description that no GSD file can have.
    """
    remarks: list[str] = []
    prm = _prm_len(slave)
    fixed = bool(slave.configs)
    if any(not config for config in slave.configs):
        raise ConfigError(
            f"slave {slave.name}: a configuration without identifier octets; a GSD file has no such module"
        )
    configs = tuple(dict.fromkeys(slave.configs))
    modules = tuple(_module(module) for module in slave.modules if module.config != EMPTY_SLOT.config)
    if slave.modules and not modules:
        raise ConfigError(f"slave {slave.name}: a modular slave with empty slots only; add a module")
    if slave.modules and len(modules) == len(slave.modules):
        remarks.append("a master may leave slots empty, which the slave refuses; add SlaveModule('empty slot', b'\\0')")
    least, most = slave.user_prm_len
    if least:
        remarks.append(
            f"user_prm_len {least}..{most}: a GSD file says the most, {most}; a master that has it sends {prm} octets"
        )
    room = slave.dpv1 and slave.max_diag_len >= FIXED_LEN + HEAD
    interval = -(-slave.min_slave_interval_ns // INTERVAL_UNIT)
    return (
        dataclasses.replace(
            slave,
            name=_text(slave.name, "the name", _LONGEST_NAME),
            vendor=_text(slave.vendor, "vendor", _LONGEST_NAME) or _UNKNOWN_VENDOR,
            revision=_text(slave.revision, "revision", _LONGEST_NAME) or _FIRST_REVISION,
            configs=configs,
            modules=(*modules, EMPTY_SLOT) if modules else (),
            presets=tuple(map(_module, slave.presets)),
            max_modules=1 if fixed else min(slave.max_modules, MAX_DATA),
            max_input_len=MAX_DATA if fixed else min(slave.max_input_len, MAX_DATA),
            max_output_len=MAX_DATA if fixed else min(slave.max_output_len, MAX_DATA),
            max_data_len=2 * MAX_DATA if fixed else min(slave.max_data_len, 2 * MAX_DATA),
            user_prm_len=(0, most),
            prm_blocks=slave.dpv1 and (slave.prm_blocks or slave.prm_blocks_required),
            prm_blocks_required=slave.dpv1 and slave.prm_blocks_required,
            ms2_max_len=slave.ms2_max_len if slave.ms2 else MAX_RECORD,
            ms2_max_initiate=slave.ms2_max_initiate if slave.ms2 else MAX_DATA,
            alarms=tuple(kind for kind in ALARM_KEYWORDS if kind in slave.alarms),
            alarm_sequence=slave.alarm_sequence if room else 0,
            extra_alarm_sap=slave.extra_alarm_sap and room,
            rates=_rates(slave),
            min_slave_interval_ns=interval * INTERVAL_UNIT,
            parameters=tuple(map(_parameter, slave.parameters)),
            diag_texts=_diag_texts(slave.diag_texts),
        ),
        tuple(remarks),
    )


def gsd_octets(slave: SlaveDescription) -> bytes:
    """The GSD file of ``slave``. Raises ConfigError for a description that no GSD file can have."""
    said, _ = as_gsd_file(slave)
    return "".join(f"{line}\r\n" for line in _lines(said, _prm_len(slave))).encode(_ENCODING)


def _text(text: str, what: str, most: int = _LONGEST_TEXT) -> str:
    """``text`` without blanks around it. Raises ConfigError if a GSD file cannot hold it."""
    text = text.strip()
    shown = shortened(text, 40)
    if not text.isprintable() or '"' in text:
        raise ConfigError(f"{what} {shown!r} holds a quote or a control character; a GSD file cannot hold it")
    if len(text) > most:
        raise ConfigError(f"{what} {shown!r} has {len(text)} characters; a GSD file allows {most}")
    try:
        octets = text.encode(_ENCODING)
    except UnicodeEncodeError:
        raise ConfigError(f"{what} {shown!r}: a GSD file has letters of Western Europe only; write it so") from None
    if not octets.isascii():
        try:
            octets.decode("utf-8")
        except UnicodeDecodeError:
            return text
        raise ConfigError(f"{what} {shown!r} would be read as other letters; leave the special ones out")
    return text


def _rates(slave: SlaveDescription) -> dict[int, int]:
    wanted: Mapping[int, int] = slave.rates or dict.fromkeys(RATES.values(), 0)
    unknown = sorted(wanted.keys() - RATES.values())
    if unknown:
        raise ConfigError(f"slave {slave.name}: {unknown[0]} bit/s is no rate of PROFIBUS; leave it out")
    return {baud: wanted[baud] or _MAX_TSDR.get(baud, _MAX_TSDR_BELOW) for baud in RATES.values() if baud in wanted}


def _prm_len(slave: SlaveDescription) -> int:
    """The octets of user parameters that the file has defaults for. Raises ConfigError."""
    least, most = slave.user_prm_len
    first = DPV1_STATUS_LEN if slave.dpv1 else 0
    reach = max(first, _reach(slave.parameters, first))
    if reach > most:
        raise ConfigError(
            f"slave {slave.name}: its parameters reach to octet {reach - 1}, user_prm_len allows "
            f"{octets_text(most)}; raise it"
        )
    return max(least, reach)


def _reach(parameters: tuple[SlaveParameter, ...], first: int) -> int:
    """The octets that ``parameters`` reach over, where the first possible one is ``first``. Raises ConfigError."""
    reach = 0
    for one in parameters:
        kind = prm_type_of(one.type)
        if kind is None:
            raise ConfigError(
                f"parameter {one.name}: type {one.type!r}; write Unsigned8, Signed16 ..., Bit(3) or BitArea(0-3)"
            )
        if one.octet < first:
            why = f"the first {DPV1_STATUS_LEN} are DPV1_Status" if first else "octets count from 0"
            raise ConfigError(f"parameter {one.name}: octet {one.octet}; {why}")
        reach = max(reach, one.octet + kind.size)
    return reach


def _module(module: SlaveModule) -> SlaveModule:
    """Its octets of user parameters hold the defaults of the named ones. Raises ConfigError."""
    name = _text(module.name, "the name of a module")
    reach = _reach(module.parameters, 0)
    if reach > MAX_USER_PRM or len(module.prm) > MAX_USER_PRM:
        raise ConfigError(f"module {name}: more than {MAX_USER_PRM} octets of user parameters; Set_Prm has no room")
    parameters = tuple(map(_parameter, module.parameters))
    octets = _with_defaults(module.prm.ljust(reach, b"\0"), parameters)
    return SlaveModule(name, module.config, octets, parameters)


def _parameter(one: SlaveParameter) -> SlaveParameter:
    """Raises ConfigError if its values do not fit its type."""
    kind = prm_type_of(one.type)
    assert kind is not None
    low, high = kind.limits
    allowed = tuple((first, last) for first, last in one.allowed) or ((low, high),)
    who = f"parameter {one.name}"
    if any(not low <= first <= last <= high for first, last in allowed):
        raise ConfigError(f"{who}: allowed {ranges_text(allowed)} do not fit {kind.text}; correct them")
    if not in_ranges(one.default, allowed):
        raise ConfigError(f"{who}: its default {one.default} is not allowed ({ranges_text(allowed)}); correct it")
    if any(not low <= value <= high for value in one.texts):
        raise ConfigError(f"{who}: a text for a value that does not fit {kind.text}; correct it")
    name = _text(one.name, "the name of a parameter")
    if not name:
        raise ConfigError("a parameter without a name; give it one")
    texts = {value: _text(text, f"{who}: the text") for value, text in sorted(one.texts.items())}
    return SlaveParameter(name, one.octet, kind.text, one.default, allowed, texts)


def _diag_texts(given: tuple[DiagText, ...]) -> tuple[DiagText, ...]:
    """In the order of a file, each condition once. Raises ConfigError."""
    found: dict[tuple[str, int, int, int], DiagText] = {}
    for kind, first, last, value, text, help in given:
        if kind not in _DIAG_ORDER:
            raise ConfigError(f"diagnosis text {text!r}: kind {kind!r}; one of {', '.join(_DIAG_ORDER)}")
        place: tuple[int | None, int | None] = (first, last)
        if kind == "channel":
            place = (None, None)
            well = 16 <= value <= 31
        elif first is None or not 0 <= first < 8 * MAX_DATA:
            well = False
        elif kind == "area":
            well = last is not None and first <= last < 8 * MAX_DATA and 0 <= value < 1 << last - first + 1
        else:
            place, well = (first, first), value == (kind == "bit")
        if not well:
            what = (
                f"error {value} of a channel; 16..31 are possible"
                if kind == "channel"
                else (f"value {value} of bits {first}..{last} is not possible; correct them")
            )
            raise ConfigError(f"diagnosis text {text!r}: {what}")
        where = (_DIAG_ORDER.index(kind), place[0] or 0, place[1] or 0, value)
        found[kind, *where[1:]] = DiagText(kind, *place, value, _text(text, "a text"), _text(help, "a help text"))
    return tuple(found[key] for key in sorted(found, key=lambda key: (_DIAG_ORDER.index(key[0]), *key[1:])))


# --- lines ------------------------------------------------------------------------------------------------------------
def _lines(slave: SlaveDescription, prm: int) -> Iterator[str]:
    """``prm``: octets of user parameters that the file has defaults for."""
    yield "; Made by dpstack gsd write from the description of a slave."
    yield "#Profibus_DP"
    yield "GSD_Revision = 5"
    yield f'Vendor_Name = "{slave.vendor}"'
    yield f'Model_Name = "{slave.name}"'
    yield f'Revision = "{slave.revision}"'
    yield f"Ident_Number = 0x{slave.ident:04X}"
    yield from ("Protocol_Ident = 0", "Station_Type = 0", "FMS_supp = 0")
    yield from (f'{key} = "{_FIRST_REVISION}"' for key in ("Hardware_Release", "Software_Release"))
    for baud, word in _RATE_WORDS.items():
        yield f"{word}_supp = {int(baud in slave.rates)}"
    for baud, max_tsdr in slave.rates.items():
        yield f"MaxTsdr_{_RATE_WORDS[baud]} = {max_tsdr}"
    yield from ("Redundancy = 0", "Repeater_Ctrl_Sig = 0", "24V_Pins = 0", 'Implementation_Type = "dpstack"')
    flags = {
        "Freeze_Mode_supp": slave.freeze,
        "Sync_Mode_supp": slave.sync,
        "Auto_Baud_supp": False,
        "Set_Slave_Add_supp": slave.set_slave_add,
        "Fail_Safe": slave.fail_safe,
    }
    for key, flag in flags.items():
        yield f"{key} = {int(flag)}"
    yield f"Min_Slave_Intervall = {slave.min_slave_interval_ns // INTERVAL_UNIT}"
    yield f"Max_Diag_Data_Len = {slave.max_diag_len}"
    yield f"Max_User_Prm_Data_Len = {slave.user_prm_len[1]}"
    yield "Slave_Family = 0"
    yield f"Modular_Station = {int(bool(slave.modules))}"
    if slave.modules:
        yield f"Max_Module = {slave.max_modules}"
        yield f"Max_Input_Len = {slave.max_input_len}"
        yield f"Max_Output_Len = {slave.max_output_len}"
        yield f"Max_Data_Len = {slave.max_data_len}"
        yield "Modul_Offset = 1"
    elif len(slave.configs) > 1:
        yield "Max_Module = 1"  # one of them: without a limit a compact station has all of its modules
    if slave.presets or len(slave.configs) == 1:
        yield "FixPresetModules = 1"
    yield from _dpv1_lines(slave)
    yield from _parameter_lines(slave, prm)
    yield from _text_lines(slave.diag_texts)
    yield from _module_lines(slave)


def _dpv1_lines(slave: SlaveDescription) -> Iterator[str]:
    yield f"DPV1_Slave = {int(slave.dpv1)}"
    if slave.dpv1:
        yield from ("C1_Read_Write_supp = 1", f"C1_Max_Data_Len = {MAX_RECORD}", f"C1_Response_Timeout = {_RESPONSE}")
        for kind in slave.alarms:
            yield f"{ALARM_KEYWORDS[kind]}_supp = 1"
        if slave.alarms:
            yield "Alarm_Type_Mode_supp = 1"
        if slave.alarm_sequence:
            yield f"Alarm_Sequence_Mode_Count = {slave.alarm_sequence}"
        yield f"Prm_Block_Structure_supp = {int(slave.prm_blocks)}"
        flags = {"Extra_Alarm_SAP_supp": slave.extra_alarm_sap, "Prm_Block_Structure_req": slave.prm_blocks_required}
        yield from (f"{key} = 1" for key, flag in flags.items() if flag)
        yield from _dxb_lines(slave)
    if slave.ms2:
        yield from ("C2_Read_Write_supp = 1", f"C2_Max_Data_Len = {slave.ms2_max_len}")
        yield from (f"C2_Response_Timeout = {_RESPONSE}", f"C2_Max_Count_Channels = {slave.ms2}")
        yield f"Max_Initiate_PDU_Length = {slave.ms2_max_initiate}"
    flags = {"WD_Base_1ms_supp": slave.wd_base_1ms, "Fail_Safe_required": slave.fail_safe_required}
    yield from (f"{key} = 1" for key, flag in flags.items() if flag)


def _dxb_lines(slave: SlaveDescription) -> Iterator[str]:
    dxb = slave.dxb
    if dxb is not None and dxb.publisher:
        yield "Publisher_supp = 1"
    if dxb is not None and dxb.links:
        yield from ("Subscriber_supp = 1", f"DXB_Max_Link_Count = {dxb.links}", f"DXB_Max_Data_Length = {dxb.octets}")


def _parameter_lines(slave: SlaveDescription, prm: int) -> Iterator[str]:
    """All named parameters, then the device's own octets and places."""
    numbers: dict[tuple[tuple[int, str], ...], int] = {}
    named = [*slave.parameters, *(one for module in (*slave.presets, *slave.modules) for one in module.parameters)]
    for one in named:
        texts = tuple(one.texts.items())
        if texts and texts not in numbers:
            numbers[texts] = len(numbers) + 1
            yield f"PrmText = {numbers[texts]}"
            yield from (f'Text({value}) = "{text}"' for value, text in texts)
            yield "EndPrmText"
    for number, one in enumerate(named, 1):
        yield f'ExtUserPrmData = {number} "{one.name}"'
        ranges = ",".join(f"{low}-{high}" if low != high else str(low) for low, high in one.allowed)
        yield f"{one.type} {one.default} {ranges}"
        if one.texts:
            yield f"Prm_Text_Ref = {numbers[tuple(one.texts.items())]}"
        yield "EndExtUserPrmData"
    status = bytearray(prm)
    if slave.dpv1:
        status[0] = DPV1_ENABLE | (FAIL_SAFE if slave.fail_safe_required else 0)
        status[2] = PRM_STRUCTURE if slave.prm_blocks_required else 0
    yield from _prm_lines(_with_defaults(bytes(status), slave.parameters), slave.parameters, 1)


def _prm_lines(octets: bytes, parameters: tuple[SlaveParameter, ...], first: int) -> Iterator[str]:
    """Constant octets and places of ``parameters``, whose numbers begin with ``first``."""
    if octets:
        yield f"Ext_User_Prm_Data_Const(0) = {_hex(octets)}"
    for number, one in enumerate(parameters, first):
        yield f"Ext_User_Prm_Data_Ref({one.octet}) = {number}"


def _hex(octets: bytes) -> str:
    return ", ".join(f"0x{octet:02X}" for octet in octets)


def _with_defaults(octets: bytes, parameters: tuple[SlaveParameter, ...]) -> bytes:
    """``octets`` with the defaults of ``parameters`` in their places."""
    image = bytearray(octets)
    for one in parameters:
        kind = prm_type_of(one.type)
        assert kind is not None
        write_bits(image, one.octet, kind, one.default)
    return bytes(image)


def _text_lines(texts: tuple[DiagText, ...]) -> Iterator[str]:
    keywords = {"bit": "Unit_Diag_Bit", "not_bit": "Unit_Diag_Not_Bit", "channel": "Channel_Diag"}
    area: tuple[int | None, int | None] | None = None
    for kind, first, last, value, text, help in texts:
        if area is not None and (kind != "area" or (first, last) != area):
            yield "Unit_Diag_Area_End"
            area = None
        if kind == "area":
            if area is None:
                area = first, last
                yield f"Unit_Diag_Area = {first}-{last}"
            keyword, number = "Value", value
        else:
            keyword, number = keywords[kind], value if first is None else first
        yield f'{keyword}({number}) = "{text}"'
        if help:
            yield f'{keyword}_Help({number}) = "{help}"'
    if area is not None:
        yield "Unit_Diag_Area_End"


def _module_lines(slave: SlaveDescription) -> Iterator[str]:
    fixed = len(slave.configs) == 1
    rows = [(module, True) for module in slave.presets]
    rows += [(module, False) for module in slave.modules if module != EMPTY_SLOT]
    for config in slave.configs:
        inputs, outputs = io_lengths(config)
        mark = "" if fixed else f" ({config.hex(' ').upper()})"  # two of them may have the same lengths
        rows.append((SlaveModule(f"{octets_text(inputs)} in, {octets_text(outputs)} out{mark}", config), fixed))
    first = len(slave.parameters) + 1
    for number, (module, preset) in enumerate(rows, 1):
        yield f'Module = "{module.name}" {_hex(module.config)}'
        yield str(number)
        if preset:
            yield "Preset = 1"
        if module.prm:
            yield f"Ext_Module_Prm_Data_Len = {len(module.prm)}"
            yield from _prm_lines(module.prm, module.parameters, first)
        first += len(module.parameters)
        yield "EndModule"
