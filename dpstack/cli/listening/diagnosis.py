"""``dpstack decode --diagnosis``: a diagnosis without its telegram, in words."""

from __future__ import annotations

import argparse

from dpstack.cli.listening.telegram_lines import names_of
from dpstack.cli.terminal import output
from dpstack.decode.diagnosis import diagnosis_lines, diagnosis_octets, diagnosis_report
from dpstack.decode.names import Names, SlaveNames
from dpstack.errors import UsageError
from dpstack.text import number_or_name


def execute(args: argparse.Namespace, text: str) -> int:
    """Explain the diagnosis in ``text``. Exit code 1 if its lengths are wrong."""
    octets = diagnosis_octets(text)
    names = names_of(args)
    slave, address = _station(names, args.address, int.from_bytes(octets[4:6], "big"))
    report = diagnosis_report(octets, slave, address)
    if args.json:
        output.json_line(report)
    else:
        for line in diagnosis_lines(report):
            output.line(line)
    return 0 if report["finding"] is None else 1


def _station(names: Names, wanted: str | None, ident: int) -> tuple[SlaveNames, int | None]:
    """Names of the station of a diagnosis, and its address if the configuration has it: the slave ``wanted`` (address
    or name), else the one with its ident number. Raises UsageError if the configuration has no slave ``wanted``.
    """
    key = None if wanted is None else number_or_name(wanted)
    found = [
        (one, at) for at, one in names.slaves.items() if (one.ident == ident if key is None else key in (at, one.name))
    ]
    if key is not None and not found:
        known = ", ".join(f"{one.name} ({at})" for at, one in names.slaves.items()) or "none: give --config"
        raise UsageError(f"no slave {wanted!r} in the configuration; known are {known}")
    if len(found) == 1:
        slave, address = found[0]
        if slave.ident in (None, ident):
            return slave, address
        output.warn(f"slave {address} ({slave.name}) is configured as 0x{slave.ident:04X}: this is another device")
    elif found:
        known = ", ".join(f"{one.name} ({at})" for one, at in found)
        output.warn(f"{known} have this ident number: --address says of which one the diagnosis is")
    return names.recognise(ident, b"") or SlaveNames(), None
