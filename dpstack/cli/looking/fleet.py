"""``dpstack fleet``: all segments of an MQTT broker, from the statuses that their gateways keep there."""

from __future__ import annotations

import argparse
import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

from dpstack.cli import options
from dpstack.cli.looking.fleet_view import FleetView
from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import UsageError
from dpstack.text import printable, shortened

if TYPE_CHECKING:
    from dpstack.bridge.mqtt.broker import Broker

_ALL: Final = "all"
#: keys of a configuration in a text, not parts of the name of a file
_KEYS: Final = re.compile(r"(?<![\w./-])(url|ca|cert|key|password_env|password_file)(?![\w./-])|(?<=\()user(?=,)")


def add_to(parser: Parser) -> None:
    parser.epilog = (
        "examples: dpstack fleet --mqtt mqtt://broker.example; dpstack fleet --mqtt mqtts://broker.example --ca ca.pem "
        "--user ops --password-file secret --json; dpstack fleet --mqtt mqtt://broker.example --seconds 15 "
        "--expect hall/press hall/saw"
    )
    parser.value("--mqtt", "URL", "the broker: mqtt://HOST:PORT, or with TLS mqtts://HOST:PORT", required=True)
    parser.value("--group", "GROUP", "only the segments of this group")
    parser.value("--ca", "FILE", "certificates (PEM) by which that of the broker is judged", type=Path)
    parser.value("--cert", "FILE", "certificate (PEM) of this program", type=Path)
    parser.value("--key", "FILE", "key (PEM) of --cert", type=Path)
    parser.value("--user", "NAME", "user at the broker", default="")
    parser.value("--password-env", "NAME", "environment variable that has the password", default="")
    parser.value("--password-file", "FILE", "file that has the password in its first line, mode 0600", type=Path)
    parser.value(
        "--expect", "GROUP/NODE", "segments that must be there: else the exit code is 1", nargs="+", default=[]
    )
    parser.value("--rebirth", "GROUP/NODE|all", "ask this gateway, or all that are known, for all births, once")
    parser.value("--seconds", "S", "end after S seconds", type=options.seconds)
    parser.run_by(execute)


def execute(args: argparse.Namespace) -> int:
    """Exit code 1 if the broker was never reached, no segment is there, an expected one is missing, or one is dead,
    silent or critical at the end."""
    options.require("aiomqtt", "dpstack fleet", "mqtt")
    try:
        from dpstack.bridge.mqtt.fleet import Fleet
        from dpstack.bridge.mqtt.fleet_reader import FleetReader
    except ImportError as error:
        raise UsageError(f"dpstack fleet needs more packages ({error}): pip install 'dpstack[mqtt]'") from None
    from dpstack.cli.terminal.nonblocking_stdout import run_unhurried
    from dpstack.cli.terminal.signals import INTERRUPTED, StopSignal, first_of

    fleet = Fleet(None if args.group is None else _name(args.group, "--group"))
    rebirth = None if args.rebirth is None else _gateways(args.rebirth)
    expected = [_gateway(text, "--expect") for text in args.expect]
    for group, _ in expected:
        if args.group not in (None, group):
            raise UsageError(
                f"--expect: {printable(group)} is not the group of --group; leave --group out, or the other"
            )
    broker = _broker(args)
    place = printable(f"{broker.host}:{broker.port}")

    async def run() -> int:
        redraws = output.redraws() and not args.json
        view = FleetView(fleet, place, json=args.json, redraws=redraws, expected=expected)
        with _own_words():
            reader = FleetReader(broker, fleet, changed=view.show, told=view.tell, rebirth=rebirth)
        view.begin(reader)
        with StopSignal() as stop:
            works = [reader.run(), *([view.watch()] if view.redraws else [])]
            await stop.or_done(first_of(*works, timeout=args.seconds))
        if stop.hurried:
            return INTERRUPTED
        return int(view.end() or not reader.was_connected)

    return run_unhurried(run(), json=args.json)


def _broker(args: argparse.Namespace) -> Broker:
    from dpstack.bridge.mqtt.broker import Broker, read_password

    with _own_words():
        return Broker(
            url=args.mqtt,
            ca=args.ca,
            cert=args.cert,
            key=args.key,
            user=args.user,
            password=read_password(args.password_env, args.password_file),
        )


@contextlib.contextmanager
def _own_words() -> Iterator[None]:
    """Name options in place of the keys of a configuration."""
    try:
        yield
    except ValueError as error:
        raise UsageError(_KEYS.sub(_option, str(error))) from None


def _option(key: re.Match[str]) -> str:
    return "--mqtt" if key[0] == "url" else f"--{key[0].replace('_', '-')}"


def _name(text: str, option: str) -> str:
    from dpstack.bridge.names import SPARKPLUG_ID

    if SPARKPLUG_ID.valid(text) != text:
        raise UsageError(f"{option} {shortened(printable(text))!r}: MQTT does not permit this name")
    return text


def _gateways(text: str) -> str | tuple[str, str]:
    """The value of ``--rebirth``."""
    if text == _ALL:
        return _ALL
    return _gateway(text, "--rebirth", ", or all")


def _gateway(text: str, option: str, more: str = "") -> tuple[str, str]:
    """Group and node of a gateway. ``more``: what else the option takes."""
    group, slash, node = text.partition("/")
    if not slash:
        raise UsageError(f"{option} {shortened(printable(text))!r}: write GROUP/NODE{more}")
    return _name(group, option), _name(node, option)
