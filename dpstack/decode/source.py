"""Where transmissions to be explained come from: a pcapng file, a waveform of a logic analyser, octets as hex digits, a
text file with such lines."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator
from typing import BinaryIO, Final

from dpstack.capture.cutter import split
from dpstack.capture.pcapng import PROFIBUS_DL, USER0, Interface, Reader
from dpstack.capture.transmission import Damage, Transmission
from dpstack.errors import CaptureFileError, UsageError
from dpstack.fdl.codec import decode

#: what may stand between hex digits
_BETWEEN: Final = re.compile(r"0x|[\s,;:-]+", re.IGNORECASE)
#: octets of one line of text; a PROFIBUS telegram has 255 at most
_MOST_LINE: Final = 1 << 20
_DAMAGED: Final = int(sum(Damage))
_PCAPNG: Final = b"\n\r\r\n"
#: the first line of a waveform: a zip archive, definitions of a VCD file, comments or headings of a CSV file
_WAVEFORM: Final = re.compile(
    rb"PK\x03\x04|<SAL|\$(?:date|version|comment|timescale|scope|var)\b|"
    rb"; ?(?:CSV|Channels|Sample ?rate)\b|META samplerate|(?:\xef\xbb\xbf)?"
    rb"(?:\"?name\"?,\"?type\"?,|Time(?: ?[\[(]\w+[\])])? ?,|(?:milli|micro|nano|pico)seconds,|logic\b)"
)
#: if a file begins with these only, its first line shows what it is
_LETTERS: Final = b'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ\xef\xbb\xbf"$; '
_NEW = tuple.__new__  # the constructor of a NamedTuple takes twice as long


def from_hex(text: str) -> bytes:
    """Octets from hex digits; blanks, commas, colons, dashes and 0x may stand between. Raises UsageError."""
    digits = _BETWEEN.sub("", text)
    try:
        return bytes.fromhex(digits)
    except ValueError:
        wrong = re.search(r"[^0-9A-Fa-f]", digits)
        why = f"{wrong[0]!r} is no hex digit" if wrong else "an octet has two hex digits, one is missing"
        raise UsageError(f"{why}; octets are written as in 68 05 05 68") from None


def read_transmissions(
    file: BinaryIO,
    name: str,
    on_interface: Callable[[Interface], None] = lambda interface: None,
    *,
    baud: int = 0,
    channel: str = "",
    on_remark: Callable[[str], None] = lambda text: None,
) -> Iterator[Transmission]:
    """The transmissions in a pcapng ``file``, in a waveform of a logic analyser (.sr, VCD, CSV), or in a text file with
    hex digits, a transmission a line.

    ``on_interface`` gets the interface of a pcapng file before its first transmission, and again if another one
    follows; of a waveform its channel. ``baud`` in bit/s and ``channel`` (its name): where the bus is in a waveform;
    0 and empty: find it. ``on_remark`` gets lines about a waveform: where the bus was found, what was left out.

    Raises CaptureFileError, after what could be read, for what cannot; a line of text that is no hex digits likewise.
    """
    head = file.read(4)
    if head == _PCAPNG:
        yield from _captured(Reader(_Again(head, file), name), on_interface)
        return
    if not head.strip(_LETTERS):
        head += file.readline(_MOST_LINE)
    if _WAVEFORM.match(head):
        from dpstack.capture.waveforms.reader import read_waveform  # with the modules for archives

        with _seekable(head, file) as whole:
            yield from read_waveform(
                whole, name, baud=baud, channel=channel, on_interface=on_interface, on_remark=on_remark
            )
    elif head.isascii() and b"\0" not in head:
        yield from _lines(_Again(head, file), name)
    else:
        yield from _captured(Reader(_Again(head, file), name), on_interface)  # which says what it is instead


@contextlib.contextmanager
def _seekable(head: bytes, file: BinaryIO) -> Iterator[BinaryIO]:
    """``file`` from its begin on, from which ``head`` was read: a pipe goes to a temporary file first."""
    if file.seekable():
        yield file
        return
    import shutil
    import tempfile

    with tempfile.TemporaryFile() as whole:
        whole.write(head)
        shutil.copyfileobj(file, whole)
        yield whole


class _Again:
    """``file`` with the octets that were read from it already."""

    def __init__(self, head: bytes, file: BinaryIO) -> None:
        self._head = head
        self._more: Callable[[int], bytes] = getattr(file, "read1", file.read)  # a pipe delivers what is there

    def read(self, size: int, /) -> bytes:
        head, self._head = self._head[:size], self._head[size:]
        return head or self._more(size)


def _captured(reader: Reader, on_interface: Callable[[Interface], None]) -> Iterator[Transmission]:
    last = None
    for interface, t_ns, octets, flags, comments in reader:
        if interface is not last:
            if interface.linktype not in (USER0, PROFIBUS_DL):
                raise CaptureFileError(
                    f"{reader.name}: packets of link type {interface.linktype}, "
                    f"PROFIBUS has {USER0} (USER0) or {PROFIBUS_DL}"
                )
            last = interface
            on_interface(interface)
        note = "; ".join(comments) if comments else ""
        yield _NEW(Transmission, (octets, t_ns, interface.bits_per_s, note, flags & _DAMAGED))
    if reader.cut:
        raise CaptureFileError(f"{reader.name}: the file ends within a block: {reader.cut}")


def _lines(file: _Again, name: str) -> Iterator[Transmission]:
    rest, number = b"", 0
    while True:
        more = file.read(1 << 16)
        *lines, rest = (rest + more).split(b"\n")
        if not more:
            lines, rest = [rest], b""
        if len(rest) > _MOST_LINE:
            raise CaptureFileError(f"{name}: line {number + 1} has more than {_MOST_LINE} characters")
        for line in lines:
            number += 1
            text = line.decode("ascii", errors="replace").partition("#")[0]
            try:
                octets = from_hex(text)
            except UsageError as error:
                raise CaptureFileError(f"{name}: line {number}: {error}") from None
            if decode(octets) is not None:
                yield Transmission(octets)
                continue
            for one in split(octets):
                yield Transmission(one)
        if not more:
            return
