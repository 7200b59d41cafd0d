"""``dpstack fdl``: one FDL service by hand, as a master station without DP."""

from __future__ import annotations

import argparse
import functools
from typing import Final

from dpstack.api.bus.events_json import Event, MasterSeen, Severity
from dpstack.api.commissioning.live_list import joined
from dpstack.api.config.config import make_config
from dpstack.api.fdl.fdl import Fdl
from dpstack.api.fdl_station.station import FdlStation
from dpstack.cli import options
from dpstack.cli.commands import on_bus
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.cli.terminal.signals import run_to_result
from dpstack.errors import FdlError, UsageError
from dpstack.text import decimal, octets_text, shortened

_SENDING: Final = ("sda", "sdn", "srd", "msrd")
_SERVICES: Final = (*_SENDING, "status", "ident", "lsap")
_LISTED: Final = ("SDA", "SDN", "SRD", "CSRD")
_ALL: Final = 127
_DP_SAPS: Final = range(48, 64)


_station: Final = options.number(decimal, 0, _ALL + 1, "station address, 0..126, or 127 for all")
_sap: Final = options.number(functools.partial(int, base=0), 0, 64, "SAP, 0..63 or 0x00..0x3F")


def _octets(text: str) -> bytes:
    try:
        return bytes.fromhex(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{shortened(text)!r} is no hex: write 01FF or '01 FF'") from None


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "example: dpstack fdl /dev/ttyUSB0 status 5 --baud 187500\n"
        "         dpstack fdl /dev/ttyUSB0 srd 5 0102 --dsap 20 --ssap 20\n"
        "         dpstack fdl /dev/ttyUSB0 sdn 127 FF --dsap 20 --yes\n\nservices:\n"
        "  sda    HEX    data with acknowledgement\n"
        "  sdn    HEX    data without acknowledgement; ADDRESS 127: to all\n"
        "  srd    [HEX]  data, and the station's reply data\n"
        "  msrd   [HEX]  as srd; the station sends its reply to all (DP-V2)\n"
        "  status        the type of the station\n"
        "  ident         vendor, controller, hardware and software of the station\n"
        "  lsap          the configuration of its SAP --dsap"
    )
    parser.value("port", "PORT", "the port")
    parser.value("service", "SERVICE", "sda, sdn, srd, msrd, status, ident or lsap", choices=_SERVICES)
    parser.value("station", "ADDRESS", "the station, 0..126; 127: all (sdn)", type=_station)
    parser.value("data", "HEX", "the data of the request", nargs="?", type=_octets, default=b"")
    parser.value("--dsap", "N", "the SAP of the station (default: its default SAP)", type=_sap)
    parser.value("--ssap", "N", "the SAP that it is sent from (default: the default SAP)", type=_sap)
    parser.flag("--high", "high priority")
    parser.flag("--yes", "send it to SAPs of DP (48 to 62), or to all stations: slaves may act on it")
    parser.value(
        "--baud",
        "B|auto",
        "the rate (default auto: found by listening, if a master is on the bus)",
        type=options.baud_or_auto,
        default="auto",
    )
    options.add_own_address(parser, "")
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 for a confirmation that is not positive."""
    on_bus.check_port(args)
    _check(args)
    try:
        line = run_to_result(_carry_out(args), f"{args.service} was done")
    except FdlError as error:
        if not args.json:
            raise
        output.json_line({**_asked(args), "status": error.status, "data": error.data.hex(), "text": str(error)})
        return 1
    if args.json:
        output.json_line({**_asked(args), **line})
    else:
        output.line(str(line["text"]))
    return 0


def _check(args: argparse.Namespace) -> None:
    """Raises UsageError for arguments that do not fit the service, and without --yes for those that slaves act on."""
    sends = args.service in _SENDING
    if args.data and not sends:
        raise UsageError(f"{args.service} sends no data: leave {args.data.hex()} out")
    if args.service == "lsap" and args.dsap is None:
        raise UsageError("lsap asks for one SAP of the station: give it with --dsap")
    if not sends and (args.ssap is not None or (args.dsap is not None and args.service != "lsap")):
        raise UsageError(f"{args.service} goes to no SAP: leave --dsap and --ssap out")
    if args.yes or not sends:
        return
    if args.station == _ALL:
        raise UsageError("address 127 is all stations, and slaves act on such telegrams: add --yes if that is meant")
    for name, sap in (("--dsap", args.dsap), ("--ssap", args.ssap)):
        if sap in _DP_SAPS:
            raise UsageError(f"{name} {sap}: DP parameterises and commands slaves by it: add --yes if that is meant")


def _asked(args: argparse.Namespace) -> dict[str, object]:
    return {"service": args.service, "address": args.station, "dsap": args.dsap, "ssap": args.ssap}


async def _carry_out(args: argparse.Namespace) -> dict[str, object]:
    """The outcome for JSON, with its line for people as ``text``."""
    baud = await on_bus.rate_of(args)

    def make_station(address: int) -> FdlStation:
        return FdlStation(make_config(args.port, baud, address, where="fdl"), on_event=on_bus.once(tell))

    def tell(event: Event) -> None:
        if event.severity is not Severity.INFO:
            output.warn(event.text)
        elif isinstance(event, MasterSeen) and event.present and not args.json:
            output.warn(f"master {event.address} is on this bus: fdl waits until it is let into the ring")

    async with joined(make_station, args.address, avoid=(args.station,)) as fdl:
        return await _ask(fdl, args)


async def _ask(fdl: Fdl, args: argparse.Namespace) -> dict[str, object]:
    to = "all stations" if args.station == _ALL else f"station {args.station}"
    name = args.service.upper()
    at = to if args.dsap is None else f"{to}, SAP {args.dsap}"
    saps = {"dsap": args.dsap, "ssap": args.ssap}
    match args.service:
        case "sda":
            await fdl.sda(args.station, args.data, high=args.high, **saps)
            return {"status": "OK", "text": f"{name} to {at}: OK, {octets_text(len(args.data))} taken"}
        case "sdn":
            await fdl.sdn(args.station, args.data, high=args.high, **saps)
            return {
                "status": "OK",
                "text": f"{name} to {at}: {octets_text(len(args.data))} sent, without acknowledgement",
            }
        case "srd" | "msrd":
            if args.service == "srd":
                answer = await fdl.srd(args.station, args.data, high=args.high, **saps)
            else:
                answer = await fdl.msrd(args.station, args.data, **saps)
            octets = f": {answer.data.hex(' ').upper()}" if answer.data else ""
            text = f"{name} to {at}: {answer.status.value}, {answer.status.text}{octets}"
            return {"status": answer.status.value, "data": answer.data.hex(), "text": text}
        case "status":
            kind = await fdl.fdl_status(args.station)
            return {"status": "OK", "type": kind.name.lower(), "text": f"{to}: {kind.text}"}
        case "ident":
            ident = await fdl.ident(args.station)
            texts = {
                "vendor": ident.vendor,
                "controller": ident.controller,
                "hardware": ident.hardware,
                "software": ident.software,
            }
            return {"status": "OK", **texts, "text": f"{to}: {ident.text}"}
        case _:
            found = await fdl.lsap_status(args.station, args.dsap)
            roles = ", ".join(f"{service} {role}" for service, role in zip(_LISTED, found.services, strict=False))
            access = "all stations" if found.access is None else f"station {found.access} only"
            what = f"{roles}; access by {access}" if roles else "a status of unknown layout"
            octets = found.octets.hex(" ").upper()
            return {"status": "OK", "data": found.octets.hex(), "text": f"{name} of {at}: {what} ({octets})"}
