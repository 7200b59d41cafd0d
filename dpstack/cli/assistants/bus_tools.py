"""The tools that look at the bus of CONFIG: ``scan``, ``why``, ``diag``, ``monitor``. They send no telegram.

They ask the run that holds the port for what it knows already; without one they listen to the port.
"""

from __future__ import annotations

import argparse
import asyncio
from collections.abc import Mapping
from pathlib import Path
from time import time_ns
from typing import Annotated, Any, Final, Literal

from msgspec import Meta, Struct

from dpstack.api.config.config import Config, load_config
from dpstack.api.control.client import find_run
from dpstack.api.control.remote import reading_through_run, stations_through_run, why_through_run
from dpstack.api.listen.heard_bus import HeardBus
from dpstack.api.listen.plant_files import load_devices
from dpstack.api.slave.station_report import KnownDevices, StationReading, station_report
from dpstack.capture.timing import ADAPTER
from dpstack.cli.assistants import answers
from dpstack.cli.assistants.foreign import Foreign, quote, quote_all, quote_or_none
from dpstack.cli.commands.on_bus import slave_of
from dpstack.cli.listening.monitor_live import CONVERTER, MonitoredPort
from dpstack.cli.looking.diag import station_address
from dpstack.errors import PortError, UsageError
from dpstack.monitor.monitor import Monitor
from dpstack.why.story import HEALTHY, Story

#: of listening, in s
LONGEST_S: Final = 30.0
USUAL_S: Final = 5.0
Seconds = Annotated[float, Meta(gt=0, le=LONGEST_S, description="how long to listen if no run answers, in s")]
_EVENTS: Final = 50
_INTEGERS: Final = 2**63
_NOTHING: Final = dict.fromkeys(("ident", "state", "master", "name"))
#: keys of a station that the answer has as the summary does
_SAME: Final = (
    *("role", "ident", "state", "master", "requests", "answers", "damaged", "no_answer", "repetitions", "late"),
    *("syncs", "lost", "max_tsdr", "diagnosis", "verdict"),
)


class Scan(Struct, kw_only=True, forbid_unknown_fields=True):
    seconds: Seconds = USUAL_S


class Why(Struct, kw_only=True, forbid_unknown_fields=True):
    slave: (
        Annotated[str, Meta(max_length=200, description="name or address of a slave of CONFIG; left out: every slave")]
        | None
    ) = None
    seconds: Seconds = USUAL_S


class Diag(Struct, kw_only=True, forbid_unknown_fields=True):
    station: Annotated[str, Meta(max_length=200, description="name of a slave of CONFIG, or a station address 0..126")]
    seconds: Seconds = USUAL_S


class BusTools:
    """The tools on the bus of the configuration ``path``, None without one. One listens at a time."""

    def __init__(self, path: Path | None) -> None:
        self._path = path
        self._lock = asyncio.Lock()

    async def _config(self) -> Config:
        if self._path is None:
            raise UsageError("this server was started without CONFIG and has no bus: dpstack mcp plant.toml")
        return await asyncio.to_thread(load_config, self._path)

    # --- the tools ---
    async def scan(self, given: Scan) -> answers.ScanAnswer:
        config = await self._config()
        found = await stations_through_run(config)
        if found is not None:
            own = {"address": found["address"], "type": "master_in_ring", **_NOTHING}  # the run itself
            stations = sorted([own, *found["stations"]], key=lambda one: int(one["address"]))
            return _scan_answer("run", 0.0, found["baud"], stations, quote_all(found["notes"]))
        heard, remarks = await self._listen(config, given.seconds)
        names = {slave.address: slave.name for slave in config.slaves}
        stations = heard.stations(names)
        there = {one["address"] for one in stations}
        remarks += [
            quote(f"slave {one.address} of the configuration was not heard")
            for one in config.slaves
            if one.address not in there
        ]
        return _scan_answer("heard", given.seconds, heard.monitor.counters.baud or None, stations, remarks)

    async def why(self, given: Why) -> answers.WhyAnswer:
        config = await self._config()
        slaves = config.slaves if given.slave is None else (slave_of(config, given.slave),)
        whole = given.slave is not None
        stories: list[Mapping[str, Any]] = []
        for slave in slaves:
            story = await why_through_run(config, slave.address, ask=False)
            if story is None:
                break
            stories.append(story)
        if stories or not slaves:
            return _why_answer("run", 0.0, stories, [], whole=whole)
        heard, remarks = await self._listen(config, given.seconds)
        told: list[Story] = [heard.story(config, slave) for slave in slaves]
        return _why_answer("heard", given.seconds, [one.as_dict() for one in told], remarks, whole=whole)

    async def diag(self, given: Diag) -> answers.DiagAnswer:
        config = await self._config()
        slave = config.find(given.station)
        address = slave.address if slave is not None else station_address(given.station, config)
        skipped: list[str] = []
        seconds = 0.0
        remarks: list[Foreign] = []
        reading: StationReading | None = None
        if slave is not None:
            reading = await reading_through_run(config.port, config, str(address), ask=False)
        if reading is None:
            seconds = given.seconds
            heard, remarks = await self._listen(config, seconds)
            reading = heard.reading(address, seconds)
        devices = KnownDevices(config.slaves, None, skipped.append)
        report = station_report(reading, slave, devices)
        return _diag_answer(report, "heard" if reading.own is None else "run", seconds, remarks)

    async def monitor(self, seconds: float) -> answers.MonitorAnswer:
        config = await self._config()
        heard, remarks = await self._listen(config, seconds)
        return monitor_answer(heard.monitor, "heard", remarks, time_ns())

    # --- listening ---
    async def _listen(self, config: Config, seconds: float) -> tuple[HeardBus, list[Foreign]]:
        """Listen to the port of ``config``, through the run that holds it or on the port itself. Raises PortError,
        UsageError."""
        async with self._lock:
            port = await asyncio.to_thread(_port_of, config)
            heard = HeardBus(load_devices(config, None), begun_ns=time_ns())
            baud = config.bus.baud
            listener = MonitoredPort(argparse.Namespace(port=port, baud=baud, json=True), heard.monitor, heard.add)
            await listener.listen(seconds)
        line = listener.line
        if line is None:
            raise PortError(f"{port}: it could not be listened to")
        remarks = [] if line.program is not None or line.source != ADAPTER else [quote(CONVERTER)]
        if not heard.monitor.counters.telegrams:
            remarks.append(
                quote(f"nothing was heard on {port} in {seconds:g} s: is the bus off, or its master stopped?")
            )
        return heard, remarks


def _port_of(config: Config) -> str:
    """The port to listen on: on "virtual" that of the run that has this configuration."""
    if not config.virtual:
        return config.port
    client = find_run(config.port, config.file)
    if client is None:
        raise PortError(
            'no run on port "virtual" with this configuration answers: start it, for instance dpstack run plant.toml; '
            "or is it stopped?"
        )
    with client:
        return str(client.help().get("name", config.port))


# --- answers ----------------------------------------------------------------------------------------------------------


def _scan_answer(
    source: Literal["run", "heard"],
    seconds: float,
    baud: int | None,
    stations: list[dict[str, Any]],
    remarks: list[Foreign],
) -> answers.ScanAnswer:
    return answers.ScanAnswer(
        source=source,
        seconds=seconds,
        baud=baud,
        stations=[
            answers.Station(
                address=one["address"],
                type=one["type"],
                ident=one["ident"],
                state=one["state"],
                master=one["master"],
                name=quote_or_none(one["name"]),
            )
            for one in stations
        ],
        remarks=remarks,
    )


def _why_answer(
    source: Literal["run", "heard"],
    seconds: float,
    stories: list[Mapping[str, Any]],
    remarks: list[Foreign],
    *,
    whole: bool,
) -> answers.WhyAnswer:
    return answers.WhyAnswer(
        source=source, seconds=seconds, stories=[_story(one, whole=whole) for one in stories], remarks=remarks
    )


def _story(story: Mapping[str, Any], *, whole: bool) -> answers.Story:
    causes = story["causes"] if whole else story["causes"][:1]
    return answers.Story(
        slave=quote(story["slave"]),
        address=story["address"],
        state=story["state"],
        healthy=story["causes"][0]["cause"] == HEALTHY,
        causes=[
            answers.Cause(
                cause=one["cause"],
                confidence=one["confidence"],
                meaning=quote(one["meaning"]),
                speaks_for=quote_all(one["for"]) if whole else [],
                against=quote_all(one["against"]) if whole else [],
                next=quote(one["next"]),
            )
            for one in causes[:6]
        ],
        steps=[
            answers.Step(
                t=one["t"],
                asked=one["asked"],
                answered=str(one["answered"]).replace(" ", "_"),
                sent=one["sent"].lower()[:1000],
                received=one["received"].lower()[:1000],
                text=quote(one["text"]),
            )
            for one in (story["steps"][-60:] if whole else ())
        ],
    )


def _diag_answer(
    report: Mapping[str, Any], source: Literal["run", "heard"], seconds: float, remarks: list[Foreign]
) -> answers.DiagAnswer:
    diagnosis, config = report["diagnosis"], report["config"]
    return answers.DiagAnswer(
        source=source,
        seconds=seconds,
        address=report["address"],
        slave=quote_or_none(report["slave"]),
        answers=report["answers"],
        healthy=report["healthy"],
        findings=quote_all(report["findings"]),
        ident=report["ident"],
        vendor=quote_or_none(report["vendor"]),
        model=quote_or_none(report["model"]),
        state=report["state"],
        master=report["master"],
        diagnosis=None
        if diagnosis is None
        else answers.Diagnosis(
            octets=diagnosis["octets"], flags=list(diagnosis["flags"]), texts=quote_all(diagnosis["texts"])
        ),
        config=None if config is None else _modules(config),
        inputs=_octets(report["inputs"]),
        outputs=_octets(report["outputs"]),
        not_read=[*quote_all(f"{service}: {why}" for service, why in report["errors"].items()), *remarks],
    )


def _modules(config: Mapping[str, Any]) -> answers.Modules:
    return answers.Modules(
        octets=config["octets"],
        input_len=config["input_len"],
        output_len=config["output_len"],
        modules=[
            answers.Module(slot=one["slot"], identifier=one["config"], text=quote(one["text"]))
            for one in config["modules"][: answers.MOST]
        ],
        finding=quote_or_none(config["finding"]),
    )


def _octets(data: Mapping[str, Any] | None) -> answers.Octets | None:
    if data is None:
        return None
    values = []
    for name, found in list(data["fields"].items())[: answers.MOST]:
        quality = data["qualities"].get(name)
        values.append(
            answers.NamedValue(
                name=quote(name),
                value=value_of(found),
                unit=quote_or_none(data["units"].get(name)),
                quality=None if quality is None else quality["quality"],
                reason=None if quality is None else quote(quality["text"]),
            )
        )
    return answers.Octets(octets=data["octets"], values=values)


def value_of(found: object) -> answers.Value:
    """``found`` with its text as data; whole numbers of more than 64 bits, which a file may have, as floats."""
    if isinstance(found, int) and not isinstance(found, bool) and not -_INTEGERS <= found < _INTEGERS:
        return float(found)
    return found if found is None or isinstance(found, (bool, int, float)) else quote(found)


def monitor_answer(
    monitor: Monitor, source: Literal["heard", "file"], remarks: list[Foreign], now_ns: int | None = None
) -> answers.MonitorAnswer:
    """The verdicts and counters of ``monitor``."""
    summary: Mapping[str, Any] = monitor.summary(now_ns)
    events = [one for one in monitor.time_line if not one.routine]
    lines: list[dict[str, Any]] = [one.as_dict(monitor.begun_ns) for one in events[-_EVENTS:]]
    return answers.MonitorAnswer(
        source=source,
        seconds=summary["seconds"],
        baud=summary["baud"],
        telegrams=summary["telegrams"],
        load=summary["load"],
        damaged=numbers(summary["damaged"]),
        profibus=summary["profibus"],
        resolution_us=summary["timing"].get("resolution_us"),
        verdict=summary["verdict"],
        reasons=quote_all(summary["reasons"]),
        masters=[
            answers.Master(
                address=int(address),
                mode=one["mode"],
                in_ring=one["in_ring"],
                silent=one["silent"],
                slaves=one["slaves"],
                gap_polls=one["gap_polls"],
                drops=one["drops"],
                token_us=_figures(one["token_us"]),
                rotation_us=_figures(one["rotation_us"]),
            )
            for address, one in summary["masters"].items()
        ],
        stations=[_station(int(address), one) for address, one in summary["stations"].items()],
        events=[
            answers.Happening(
                t=line["t"], event=str(line["event"]), address=line.get("address"), text=quote(line["text"])
            )
            for line in lines
        ],
        events_left_out=max(0, len(events) - _EVENTS) + monitor.left_out,
        not_heard=quote_all(summary["not_heard"]),
        remarks=remarks,
    )


def _station(address: int, one: Mapping[str, Any]) -> answers.MonitoredStation:
    return answers.MonitoredStation(
        address=address,
        name=quote_or_none(one["name"]),
        model=quote_or_none(one["model"]),
        tsdr_us=_figures(one["tsdr_us"]),
        diagnosis_texts=quote_all(one["diagnosis_texts"] or ()),
        reasons=quote_all(one["reasons"]),
        **{key: one[key] for key in _SAME},
    )


def _figures(found: Mapping[str, float] | None) -> answers.Figures | None:
    return (
        None
        if found is None
        else answers.Figures(**{key: found.get(key) for key in ("min", "mean", "p50", "p99", "max")})
    )


def numbers(found: Mapping[str, Any]) -> list[answers.Number]:
    """Numbers by their names."""
    return [answers.Number(name=name, number=number) for name, number in found.items()]
