"""Reads files of logic analysers: finds the bus in them and yields its transmissions."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Iterator
from typing import BinaryIO, Final

from dpstack.capture.pcapng import Interface
from dpstack.capture.timing import WAVEFORM, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.capture.waveforms.analyser_table import CharacterTable
from dpstack.capture.waveforms.characters import Assembler, Sampler
from dpstack.capture.waveforms.levels import Waveform
from dpstack.capture.waveforms.search import find_line, rate_text, samples_text
from dpstack.capture.waveforms.sr import SessionFile
from dpstack.capture.waveforms.tables import LevelTable
from dpstack.capture.waveforms.vcd import ValueChanges
from dpstack.errors import CaptureFileError
from dpstack.phy.uart import Character
from dpstack.text import printable, some_of
from dpstack.units import NS_PER_S, baud_text

_CHARACTERS: Final = re.compile(rb'(?:\xef\xbb\xbf)?(?:Time \[s\],Value,|"?name"?,"?type"?,)')


def read_waveform(
    file: BinaryIO,
    name: str,
    *,
    baud: int,
    channel: str,
    on_interface: Callable[[Interface], None],
    on_remark: Callable[[str], None],
) -> Iterator[Transmission]:
    """The transmissions in ``file``, which is read twice, timed by its samples from the begin of the capture on.

    ``baud``: the rate of the bus (0: find it), ``channel``: the channel's name (empty: find it). ``on_remark`` gets
    lines for the user: the line that was found, and what was left out. Raises CaptureFileError, UsageError.
    """

    def remark(text: str) -> None:
        on_remark(printable(f"{name}: {text}"))

    file.seek(0)
    if _CHARACTERS.match(file.read(64)):
        table = CharacterTable(file, name, baud, channel)
        for text in table.remarks:
            remark(text)
        remark(f"{table.channel}, {baud_text(table.baud)}")
        on_interface(_interface(table.channel, table.baud, table.resolution_ns))
        yield from _transmissions(([one] for one in table.characters()), table.baud, remark)
        return
    waveform = _open(file, name)
    yield from _sampled(waveform, baud, channel, on_interface, remark)


def _open(file: BinaryIO, name: str) -> Waveform:
    file.seek(0)
    head = file.read(8)
    file.seek(0)
    if head.startswith(b"PK"):
        return SessionFile(file, name)
    if head == b"<SALEAE>":
        raise CaptureFileError(f"{name}: a binary export of Saleae Logic; export the channels as CSV")
    if head == b"libsigro":
        raise CaptureFileError(f"{name}: lines for the eye (bits, hex, ascii) of sigrok-cli; write .sr, or -O vcd")
    return ValueChanges(file, name) if head.lstrip().startswith(b"$") else LevelTable(file, name)


def _sampled(
    waveform: Waveform,
    baud: int,
    channel: str,
    on_interface: Callable[[Interface], None],
    remark: Callable[[str], None],
) -> Iterator[Transmission]:
    if waveform.begin_ns < 0:
        remark(f"the times count from its begin, {waveform.begin_ns / NS_PER_S:g} s")
        waveform.begin_ns = 0
    line = find_line(waveform, baud, channel)
    name = waveform.channels[line.channel]
    for text in waveform.remarks:
        remark(text)
    inverted = ", inverted" if line.inverted else ""
    samples = f"{rate_text(waveform.rate)}, {samples_text(waveform.rate / line.baud)}" if waveform.stated else ""
    others = f"; telegrams also on {some_of(line.others)}, choose with --channel" if line.others else ""
    remark(f"channel {name!r}{inverted}, {baud_text(line.baud)}" + (f", {samples}" if samples else "") + others)
    if line.remark:
        remark(line.remark)
    on_interface(_interface(name + inverted, line.baud, waveform.period_ns or math.ceil(NS_PER_S / waveform.rate)))
    sampler = Sampler(waveform.rate, line.baud, inverted=line.inverted, begin_ns=waveform.begin_ns)
    pieces = waveform.pieces([line.channel])
    yield from _transmissions((sampler.add(start, levels) for _, start, levels in pieces), line.baud, remark)


def _transmissions(
    batches: Iterable[Iterable[Character]], baud: int, remark: Callable[[str], None]
) -> Iterator[Transmission]:
    assembler = Assembler(baud)
    try:
        for characters in batches:
            yield from assembler.add(characters)
    except CaptureFileError:
        yield from assembler.close()
        raise
    yield from assembler.close()
    errors = [
        f"{count} with {kind} errors"
        for count, kind in ((assembler.parity_errors, "parity"), (assembler.framing_errors, "framing"))
        if count
    ]
    if errors:
        remark(f"characters {' and '.join(errors)}")


def _interface(channel: str, baud: int, resolution_ns: int) -> Interface:
    timing = LineTiming(WAVEFORM, resolution_ns)
    channel = printable(channel)
    description = f"channel {channel} of a logic analyser, {baud_text(baud)}, 8 data bits, even parity; {timing.text}"
    return Interface(name=channel, bits_per_s=baud, description=description, unit=9)
