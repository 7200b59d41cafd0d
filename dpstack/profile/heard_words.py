"""The words of a drive and its parameter access, for a program that only listens to the bus: plain JSON data.

:class:`HeardDrive` reads the process data of another master and its drive with the plugin of the drive.
:func:`record_fields` reads record 47.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final

from dpstack.errors import PduError
from dpstack.profile.drive_profile import DriveProfile
from dpstack.profile.master.core import NOT_NAMED
from dpstack.profile.master.mapped_core import MappedCore
from dpstack.profile.model import process_data_map
from dpstack.profile.model.drive_type import CHANNEL_LEN, CHECK_SETTINGS
from dpstack.profile.model.param_errors import error_text
from dpstack.profile.record47.formats import FORMATS, UnknownFormatError
from dpstack.profile.record47.pdu import Attribute, ErrorValue, Request, RequestId, Response, Values

Fields = dict[str, object]
#: values of one parameter that the text of a record shows
_SHOWN_VALUES: Final = 4


class HeardDrive:
    """The process data of the drive ``profile`` with ``telegram`` and ``options``, octets of any content.

    Raises ConfigError if the options are not those of the drive.
    """

    def __init__(self, profile: DriveProfile, name: str, telegram: str | None, options: dict[str, object]) -> None:
        self._core = core = profile.core(name, telegram, {**options, CHECK_SETTINGS: False})
        if isinstance(core, MappedCore) and getattr(core, "inputs_map", None) is None:
            core.inputs_map, core.outputs_map = core.present_maps()  # as a start writes them, or as they were
        self._channel = CHANNEL_LEN if core.telegram.channel else 0
        self._control: int | None = None

    def outputs(self, octets: bytes) -> Fields:
        """Parameter channel, control word with the names of its bits, set point in parts of the reference, the fields
        of the map; ``text``: all of it in a few words. Empty for another length."""
        return self._read(octets, self._core.telegram.output_octets, self._outputs)

    def inputs(self, octets: bytes) -> Fields:
        """Parameter channel, status word with the names of its bits, state, actual values, faults and warnings, the
        fields of the map; ``text``: all of it in a few words. Empty for another length."""
        return self._read(octets, self._core.telegram.input_octets, self._inputs)

    def parameter(self, number: int, subindex: int) -> str:
        """The name of a parameter; empty if it has none."""
        spec = self._core.parameter(number, subindex)
        return "" if spec is None else spec.label

    def _read(self, octets: bytes, length: int, read: Callable[[bytes], Fields]) -> Fields:
        if len(octets) != length:
            return {}
        try:
            return read(octets)
        except Exception as error:  # a plugin may come from anybody, and the octets too
            return {"error": f"the plugin of {self._core.drive} cannot read this: {type(error).__name__}: {error}"}

    def _outputs(self, octets: bytes) -> Fields:
        core = self._core
        found, texts = self._channel_fields(octets, order=True)
        process = octets[self._channel :]
        self._control, setpoint = control, _ = core.decode(process)
        if control is not None:
            found["control_word"] = f"0x{control:04x}"
            found["control_bits"] = names = list(core.table.control.names(control))
            texts.append(f"{core.table.control.name} {control:04X} ({' '.join(names) or 'no bit set'})")
        if setpoint is not None:
            found["setpoint"] = round(setpoint, 6)
            texts.append(f"set point {setpoint:.1%}")
        return self._with_map(found, texts, process, outputs=True)

    def _inputs(self, octets: bytes) -> Fields:
        core = self._core
        found, texts = self._channel_fields(octets, order=False)
        status = core.read_inputs(octets, self._control)
        word = core.status_word & 0xFFFF
        found |= {"status_word": f"0x{word:04x}", "status_bits": list(status.bits), "state": str(status.state)}
        texts.append(f"{core.table.status.name} {word:04X}: {status.state}")
        for name in ("speed", "current", "torque"):
            value = getattr(status, name)
            if value is not None:
                found[name] = round(value, 6)
                texts.append(f"{name} {value:.1%}")
        if status.frequency_hz is not None:
            found["frequency_hz"] = round(status.frequency_hz, 3)
        faults = [fault for fault in status.faults if fault != NOT_NAMED]  # nobody asks for the name here
        if faults:
            found["faults"] = faults
            texts.append(f"fault {', '.join(faults)}")
        if status.warnings:
            found["warnings"] = list(status.warnings)
            texts.append(f"warning {', '.join(status.warnings)}")
        return self._with_map(found, texts, octets[self._channel :], outputs=False)

    def _channel_fields(self, octets: bytes, *, order: bool) -> tuple[Fields, list[str]]:
        access = self._core.access
        if not self._channel or access is None:
            return {}, []
        words = access.fields(octets[: self._channel], order=order, find=self._core.parameter)
        if not words:
            return {"PKW": None}, []
        return {"PKW": words}, [str(words["text"])]

    def _with_map(self, found: Fields, texts: Sequence[str], process: bytes, *, outputs: bool) -> Fields:
        core = self._core
        if isinstance(core, MappedCore):
            data_map, at = (core.outputs_map, core.outputs_at) if outputs else (core.inputs_map, core.inputs_at)
            words = [int.from_bytes(process[n : n + 2], core.octet_order) for n in range(0, len(process) - 1, 2)]
            values = {} if data_map is None else process_data_map.decoded(data_map.fields, words[at:])
            if values:
                found["map"] = values
        return found | {"text": ", ".join(texts)}


# --- record 47 --------------------------------------------------------------------------------------------------------
def record_fields(octets: bytes, request: bool, name_of: Callable[[int, int], str]) -> Fields:
    """Record 47, a request or a response; empty if ``octets`` are none of the profile's.

    ``name_of``: the name of a parameter by PNU and subindex, empty if it has none.
    """
    try:
        return _request(octets, name_of) if request else _response(octets)
    except UnknownFormatError as error:
        return {"error": str(error), "text": str(error)}
    except PduError:
        return {}


def _request(octets: bytes, name_of: Callable[[int, int], str]) -> Fields:
    asked = Request.parse(octets)
    parameters: list[Fields] = []
    texts = []
    for number, address in enumerate(asked.addresses):
        known = address.attribute in Attribute.__members__.values()
        attribute = Attribute(address.attribute).name.lower() if known else f"attribute {address.attribute:#x}"
        name = name_of(address.pnu, address.subindex)
        one: Fields = {
            "PNU": address.pnu,
            "subindex": address.subindex,
            "elements": address.elements,
            "attribute": attribute,
            "name": name or None,
        }
        text = f"{attribute} of {address}" if attribute != "value" else str(address)
        text += f" {name}" if name else ""
        if asked.values:
            one["values"] = values = _values(asked.values[number])
            text += f" = {_shown(values)}"
        parameters.append(one)
        texts.append(text)
    what = RequestId(asked.id).name.lower()
    return {
        "Request_Reference": asked.reference,
        "Request_ID": what,
        "Axis": asked.object,
        "parameters": parameters,
        "text": f"{what} {'; '.join(texts) or 'no parameter'}",
    }


def _response(octets: bytes) -> Fields:
    answered = Response.parse(octets)
    known = answered.id in RequestId.__members__.values()
    what = RequestId(answered.id).name.lower() if known else f"request id {answered.id:#x}"
    results: list[Fields] = []
    texts = []
    for result in answered.results:
        if isinstance(result, ErrorValue):
            text = error_text(result.number, result.info)
            results.append({"error": result.number, "info": result.info, "text": text})
            texts.append(text)
        else:
            values = _values(result)
            form = FORMATS.get(result.format)
            results.append({"format": f"{result.format:#04x}" if form is None else form.name, "values": values})
            texts.append(_shown(values))
    return {
        "Response_Reference": answered.reference,
        "Request_ID": what,
        "negative": answered.negative,
        "Axis": answered.object,
        "results": results,
        "text": f"{what}{' refused' if answered.negative else ''}: {'; '.join(texts) or f'{answered.count} done'}",
    }


def _values(values: Values) -> list[object]:
    form = FORMATS[values.format]
    return [_plain(form.value(raw)) for raw in values.raws]


def _plain(value: object) -> object:
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and not abs(value) < float("inf"):  # JSON has no infinite numbers
        return None
    return value


def _shown(values: list[object]) -> str:
    more = len(values) - _SHOWN_VALUES
    return ", ".join(map(str, values[:_SHOWN_VALUES])) + (f" and {more} more" if more > 0 else "") or "nothing"
