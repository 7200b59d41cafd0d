"""Report on one station, read by the class 2 services: diagnosis, configuration, inputs and outputs, in words.

The station may belong to any master. Nothing is written and nobody is parameterised: Slave_Diag, Get_Cfg, RD_Inp and
RD_Outp only.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final, Literal, TypedDict

from msgspec import Meta, Struct

from dpstack.api.config.slave import SlaveConfig
from dpstack.api.gsd_info import bundled, gsd_files, read_gsd
from dpstack.api.slave.class2 import Class2, Configuration
from dpstack.api.slave.quality import judged_by
from dpstack.devices import finding
from dpstack.dp.doubts import doubts_of
from dpstack.dp.field_map import as_json
from dpstack.dp.pdu.diag_bits import Flag, SetBy
from dpstack.dp.pdu.diag_texts import block_texts
from dpstack.dp.pdu.diagnosis import Diagnosis, SlaveView, view_of
from dpstack.dp.slot_map import Direction, Slot, slot_map
from dpstack.errors import ConfigError, GsdError, ServiceRefused, SlaveError, SlaveTimeout
from dpstack.gsd.configuration import modules_of_config
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import Device, Module
from dpstack.gsd.module_comparison import compare_modules
from dpstack.plant.quality import Quality
from dpstack.text import octets_text

#: the services by the name of their octets in a reading
SERVICES: Final = {"diagnosis": "Slave_Diag", "config": "Get_Cfg", "inputs": "RD_Inp", "outputs": "RD_Outp"}
#: findings for the states before data exchange
_WAITS: Final = {
    SlaveView.WAIT_PRM: "is not in data exchange: it waits for parameters, no master has it",
    SlaveView.WAIT_CFG: "is not in data exchange: master {master} has parameterised it, and it is not ready",
    SlaveView.UNKNOWN: "is not in data exchange: its diagnosis names no master",
}
_NO_ANSWER: Final = (
    "does not answer: check power, cable, address switch and the baud rate; `dpstack scan` lists those who answer"
)
_NO_SLAVE: Final = "answers, and refuses Slave_Diag ({status}): it may be a master, or no DP slave"
#: ``status`` of a reading without a diagnosis for which nobody sent a telegram: the station may be healthy
UNASKED: Final = "unasked"


Hex = Annotated[str, Meta(pattern=r"^(?:[0-9a-fA-F]{2})*$")]


class ServiceOctets(TypedDict):
    """The octets of a :class:`StationReading`, by the keys of :data:`SERVICES`."""

    diagnosis: str | None
    config: str | None
    inputs: str | None
    outputs: str | None


def no_octets() -> ServiceOctets:
    return {"diagnosis": None, "config": None, "inputs": None, "outputs": None}


class StationReading(Struct, frozen=True):
    """The octets that the station at ``address`` gave, in hex; None if it gave none, then ``errors`` has the reason
    by the name of the service. In the JSON of ``diag``.

    ``own``: address of the master that asked, None if nobody did; ``source``: "run", "class2" or "heard". ``status`` is
    "" if the diagnosis was read or nobody answered; otherwise the negative answer to Slave_Diag ("RS", "UE" ...),
    "unreadable", "master" for a station of the token ring, or :data:`UNASKED`. ``state`` and ``master``: of a station
    without a diagnosis here, as its other telegrams show them.
    """

    address: Annotated[int, Meta(ge=0, le=126)]
    own: int | None
    source: str
    status: str
    diagnosis: Hex | None
    config: Hex | None
    inputs: Hex | None
    outputs: Hex | None
    errors: Mapping[str, str]
    state: str | None = None
    master: int | None = None


async def read_station(
    class2: Class2, address: int, own: int, source: str, masters: Collection[int] = ()
) -> StationReading:
    """Read the station at ``address`` (0..126). Refusals and silence of the station are part of the reading.

    ``masters``: the stations in the token ring. Raises UsageError, BusError.
    """
    found = no_octets()
    errors: dict[str, str] = {}
    status = ""
    try:
        diagnosis = await class2.diagnosis(address)
    except SlaveError as error:
        if address in masters:
            status = "master"
        elif isinstance(error, ServiceRefused):
            status = error.status
        elif not isinstance(error, SlaveTimeout):
            status = "unreadable"
        return StationReading(address, own, source, status, **found, errors={SERVICES["diagnosis"]: str(error)})
    found["diagnosis"] = diagnosis.build().hex()
    wanted: dict[Literal["config", "inputs", "outputs"], Callable[[], Any]] = {"config": lambda: class2.config(address)}
    if view_of(diagnosis) is SlaveView.DATA_EXCHANGE:
        wanted |= {"inputs": lambda: class2.inputs(address), "outputs": lambda: class2.outputs(address)}
    for name, read in wanted.items():
        try:
            found[name] = (await read()).octets.hex()
        except SlaveError as error:
            errors[SERVICES[name]] = str(error)
    return StationReading(address, own, source, status, **found, errors=errors)


# --- devices by their ident number ------------------------------------------------------------------------------------


class KnownDevices:
    """Devices of GSD files by ident number: those of ``folder`` (with the folders in it), then those of the configured
    ``slaves``, then the files that come with dpstack.

    ``on_skipped`` gets one line for each file of the folder that cannot be used. Raises ConfigError for a folder
    without GSD files.
    """

    def __init__(
        self,
        slaves: Iterable[SlaveConfig] = (),
        folder: str | Path | None = None,
        on_skipped: Callable[[str], None] = lambda text: None,
    ) -> None:
        self._by_ident: dict[int, Device] = {}
        for path in () if folder is None else gsd_files(Path(folder)):
            try:
                self._add(read_gsd(path).device)
            except (ConfigError, GsdError) as error:
                on_skipped(f"skipped: {error}")
        for slave in slaves:
            if slave.device is not None:
                self._add(slave.device)

    def _add(self, device: Device) -> None:
        if device.ident is not None:
            self._by_ident.setdefault(device.ident, device)

    def find(self, ident: int) -> Device | None:
        """The device with the ident number; None if no file has it."""
        if ident in self._by_ident:
            return self._by_ident[ident]
        for name in bundled():
            with contextlib.suppress(ConfigError, GsdError):
                device = read_gsd(name).device
                if device.ident == ident:
                    self._add(device)
                    return device
        return None


# --- the report -------------------------------------------------------------------------------------------------------


def station_report(
    reading: StationReading, slave: SlaveConfig | None = None, devices: KnownDevices | None = None
) -> dict[str, Any]:
    """The report as plain data, its keys as docs/how-to/diag.md has them. ``slave``: as it is configured, None for a
    station that the configuration does not have."""
    diagnosis = None if reading.diagnosis is None else Diagnosis.parse(bytes.fromhex(reading.diagnosis))
    head: dict[str, Any] = {
        "address": reading.address,
        "slave": None if slave is None else slave.name,
        "source": reading.source,
        "own": reading.own,
        "answers": diagnosis is not None or bool(reading.status),
    }
    if diagnosis is None and reading.status == UNASKED:
        return _unasked(reading, slave, head)
    if diagnosis is None:
        finding = _NO_ANSWER
        if reading.status == "unreadable":
            finding = f"answers, and not as a DP slave does: {next(iter(reading.errors.values()), '')}"
        elif reading.status == "master":
            finding = "is a master in the token ring: it has no diagnosis of a slave"
        elif reading.status:
            finding = _NO_SLAVE.format(status=reading.status)
        nothing = dict.fromkeys(
            ("ident", "vendor", "model", "state", "master", "diagnosis", "config", "inputs", "outputs")
        )
        return {**head, "healthy": False, "findings": [finding], **nothing, "errors": {**reading.errors}}
    device = None if devices is None else devices.find(diagnosis.ident)
    if slave is not None and slave.params.is_other_ident(diagnosis.ident):
        expected: SlaveConfig | None = None  # another device: its names and modules are not those of the configuration
    else:
        expected = slave
        if slave is not None and slave.device is not None:
            device = slave.device
    config = None if reading.config is None else Configuration.of(bytes.fromhex(reading.config))
    modules = _modules(config, expected, device)
    texts = block_texts(
        diagnosis,
        None if device is None else DiagTexts(device, modules or ()),
        dpv1=_is_dpv1(expected, device),
    )
    state = view_of(diagnosis)
    findings = list(_findings(diagnosis, state, slave, config, texts))
    return {
        **head,
        "healthy": not findings,
        "findings": findings,
        "ident": f"0x{diagnosis.ident:04X}",
        "vendor": None if device is None else device.vendor,
        "model": _model(device, diagnosis.ident),
        "state": state.value,
        "master": diagnosis.master,
        "diagnosis": {
            "octets": diagnosis.build().hex(),
            "flags": list(diagnosis.flags),
            "texts": [*diagnosis.texts, *texts],
        },
        "config": None if config is None else _config_dict(config, modules, device),
        "inputs": _data(reading.inputs, expected, Direction.INPUT, diagnosis),
        "outputs": _data(reading.outputs, expected, Direction.OUTPUT, diagnosis),
        "errors": dict(reading.errors),
    }


def _unasked(reading: StationReading, slave: SlaveConfig | None, head: Mapping[str, Any]) -> dict[str, Any]:
    """The report on a station whose diagnosis is not known, because nobody asked for it: not healthy, not ill."""
    config = None if reading.config is None else Configuration.of(bytes.fromhex(reading.config))
    return {
        **head,
        "answers": None if reading.state is None else True,
        "healthy": None,
        "findings": [f"its diagnosis is not known: {next(iter(reading.errors.values()), 'nobody asked for it')}"],
        **dict.fromkeys(("ident", "vendor", "model", "diagnosis")),
        "state": reading.state,
        "master": reading.master,
        "config": None if config is None else _config_dict(config, _modules(config, slave, None), None),
        "inputs": _data(reading.inputs, slave, Direction.INPUT, None),
        "outputs": _data(reading.outputs, slave, Direction.OUTPUT, None),
        "errors": {**reading.errors},
    }


def _data(
    octets: str | None, slave: SlaveConfig | None, direction: Direction, diagnosis: Diagnosis | None
) -> dict[str, Any] | None:
    """Octets and named values of one direction, with the quality of those that are not good by the diagnosis."""
    if octets is None:
        return None
    fields = None if slave is None else dict(slave.fields)[direction]
    if slave is None or fields is None or 2 * fields.length != len(octets):
        return {"octets": octets, "fields": {}, "units": {}, "qualities": {}}
    image, setup = bytes.fromhex(octets), slave.params
    doubts = doubts_of(setup.slots, diagnosis, texts=setup.texts, dpv1=setup.has_messages)
    found = {name: judged_by(doubts, field, direction, image) for name, field in fields.fields.items()}
    return {
        "octets": octets,
        "fields": as_json(fields.values(image)),
        "units": fields.units,
        "qualities": {
            name: {"quality": one.quality.value, "text": one.reason.with_note(one.note)}
            for name, one in found.items()
            if one.quality is not Quality.GOOD
        },
    }


def _is_dpv1(slave: SlaveConfig | None, device: Device | None) -> bool:
    """Whether its device related blocks are alarms and status messages."""
    if slave is not None and slave.params.dpv1 is not None:
        return True
    return device is not None and device.dpv1.slave


def _model(device: Device | None, ident: int) -> str | None:
    if device is not None:
        return device.model
    return next((one.title for one in finding.with_ident(ident)), None)


def _modules(
    config: Configuration | None, slave: SlaveConfig | None, device: Device | None
) -> tuple[Module | None, ...] | None:
    """The modules behind the identifier octets in slot order; None if no GSD file has them."""
    if config is None:
        return None
    if slave is not None and slave.params.texts is not None and config.octets == slave.params.config:
        return slave.params.texts.modules or None  # also if two modules have the same octets
    return None if device is None else modules_of_config(device, config.octets)


def _config_dict(
    config: Configuration, modules: tuple[Module | None, ...] | None, device: Device | None
) -> dict[str, Any]:
    slots: tuple[Slot, ...] = ()
    if config.finding is None:
        slots = slot_map(config.octets, None if device is None else DiagTexts(device, modules or ())).slots
    return {
        "octets": config.octets.hex(),
        "input_len": config.input_len,
        "output_len": config.output_len,
        "modules": [
            {**slot.as_dict(), "name": None if modules is None else slot.name, "text": slot.text} for slot in slots
        ],
        "finding": config.finding,
    }


def _findings(
    diagnosis: Diagnosis,
    state: SlaveView,
    slave: SlaveConfig | None,
    config: Configuration | None,
    texts: tuple[str, ...],
) -> Iterator[str]:
    """One line each; none if the station is in data exchange, as configured, and reports nothing."""
    exchanging = state is SlaveView.DATA_EXCHANGE
    if not exchanging:
        yield _WAITS[state].format(master=diagnosis.master)
    if slave is not None and slave.params.is_other_ident(diagnosis.ident):
        wanted = slave.params.ident or 0
        yield f"is another device: ident 0x{diagnosis.ident:04X} instead of 0x{wanted:04X} of the configuration"
    elif slave is not None and config is not None and config.octets != slave.params.config:
        yield f"its configuration is another one: {_difference(slave, config.octets)}"
    told = texts if diagnosis.ext_diag else ()
    for flag in _conspicuous(diagnosis, exchanging=exchanging):
        if not (told and flag.name == "ext_diag"):  # the texts say it
            yield f"{flag.text} ({flag.name}): {flag.remedy}"
    yield from told


def _conspicuous(diagnosis: Diagnosis, *, exchanging: bool) -> Iterator[Flag]:
    """The flags with a remedy that the slave itself sets, without those that only say that it waits for its master."""
    for flag in diagnosis.findings:
        waits = not exchanging and flag.name in ("prm_req", "station_not_ready")
        if flag.remedy and flag.set_by is SetBy.SLAVE and not waits:
            yield flag


def _difference(slave: SlaveConfig, real: bytes) -> str:
    """The first slot and the first octet that differ from the configuration of ``slave``."""
    wanted, texts = slave.params.config, slave.params.texts
    modules, first_slot = ((), 1) if texts is None else (texts.modules, texts.first_slot)
    slot = compare_modules(wanted, real, slave.device, modules, first_slot).short
    pairs = enumerate(zip(wanted, real, strict=False))
    at = next((number for number, (one, other) in pairs if one != other), min(len(wanted), len(real)))
    octets = f"{octets_text(len(real))} {real.hex(' ').upper()} instead of {wanted.hex(' ').upper()}"
    return f"{slot}{slot and '; '}octet {at + 1} differs, {octets}"
