"""Where transmissions to be explained come from: a pcapng file, a waveform of a logic analyser, octets as hex digits, a
text file with such lines."""

from __future__ import annotations

import codecs
import contextlib
import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import chain
from typing import BinaryIO, Final, TypeVar

from dpstack.capture.pcapng import PROFIBUS_DL, USER0, Interface, Reader
from dpstack.capture.transmission import Columns, Transmission
from dpstack.decode.log_text import LogReader, Unread
from dpstack.errors import CaptureFileError
from dpstack.fdl.telegram import Kind

#: octets of one line of text; a PROFIBUS telegram has 255 at most
_MOST_LINE: Final = 1 << 20
#: first octets of telegrams
_STARTS: Final = frozenset(bytes((kind,)) for kind in Kind)
_PCAPNG: Final = b"\n\r\r\n"
_UTF_16: Final = (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
#: controls that stand in no text
_NO_TEXT: Final = frozenset(range(0x20)).difference(b"\t\n\r\f\b\x1b")
#: the first line of a waveform: a zip archive, definitions of a VCD file, comments or headings of a CSV file
_WAVEFORM: Final = re.compile(
    rb"PK\x03\x04|<SAL|libsigrok \d|\$(?:date|version|comment|timescale|scope|var)\b|"
    rb"; ?(?:CSV|Channels|Sample ?rate)\b|META samplerate|(?:\xef\xbb\xbf)?"
    rb"(?:\"?name\"?,\"?type\"?,|Time(?: ?[\[(]\w+[\])])? ?,|(?:milli|micro|nano|pico)seconds,|logic\b)"
)
#: the second line of a log in columns, whose heading may be that of a waveform (Time,Dir,Data)
_OF_LOG: Final = re.compile(rb"(?i)[\s,;\"](?:[TR]X|->|<-)[\s,;:\"]|\b(?:[0-9A-F]{2} ){2}[0-9A-F]{2}\b")
#: if a file begins with these only, its first line shows what it is
_LETTERS: Final = b'abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ\xef\xbb\xbf"$; '

Batch = TypeVar("Batch")


def read_transmissions(
    file: BinaryIO,
    name: str,
    on_interface: Callable[[Interface], None] = lambda interface: None,
    *,
    on_unread: Callable[[Unread], None] | None = None,
    baud: int = 0,
    channel: str = "",
    on_remark: Callable[[str], None] = lambda text: None,
) -> Iterator[Transmission]:
    """The transmissions in a pcapng ``file``, in a waveform of a logic analyser (.sr, VCD, CSV), or in a text file: hex
    digits, a transmission a line, or lines of a log (:mod:`dpstack.decode.log_text`).

    ``on_interface`` gets the interface of a pcapng file before its first transmission, and again if another one
    follows; of a waveform its channel. ``on_unread`` gets each line of a text without octets; None: such a line raises
    CaptureFileError. ``baud`` in bit/s and ``channel`` (its name): where the bus is in a waveform; 0 and empty: find
    it. ``on_remark`` gets lines about a waveform: where the bus was found, what was left out.

    Raises CaptureFileError, after what could be read, for what cannot.
    """
    return chain.from_iterable(
        read_batches(file, name, on_interface, on_unread=on_unread, baud=baud, channel=channel, on_remark=on_remark)
    )


def read_batches(
    file: BinaryIO,
    name: str,
    on_interface: Callable[[Interface], None] = lambda interface: None,
    *,
    on_unread: Callable[[Unread], None] | None = None,
    baud: int = 0,
    channel: str = "",
    on_remark: Callable[[str], None] = lambda text: None,
) -> Iterator[Columns | Sequence[Transmission]]:
    """The same as :func:`read_transmissions`, in pieces as the file delivers them: of a pcapng file some thousand
    transmissions of one interface, else one."""
    head = file.read(4)
    if head == _PCAPNG:
        reader = Reader(_Again(head, file), name)
        yield from of_bus(reader, reader.batches(), on_interface)
        return
    if not head:
        raise CaptureFileError(f"{name}: empty")
    if not head.strip(_LETTERS):
        head += file.readline(_MOST_LINE)
    second = b""
    if head.endswith(b"\n") and _WAVEFORM.match(head):
        second = file.readline(_MOST_LINE)
        head += second
    if _WAVEFORM.match(head) and not _OF_LOG.search(second):
        from dpstack.capture.waveforms.reader import read_waveform  # with the modules for archives

        with _seekable(head, file) as whole:
            for one in read_waveform(
                whole, name, baud=baud, channel=channel, on_interface=on_interface, on_remark=on_remark
            ):
                yield (one,)
    elif _is_text(head):
        for one in _lines(_Again(head, file), head, name, on_unread):
            yield (one,)
    elif head[:1] in _STARTS:
        raise CaptureFileError(f"{name}: octets, not their hex digits: xxd FILE | dpstack decode - explains them")
    else:
        for _, batch in Reader(_Again(head, file), name).batches():  # raises, and says what it is instead
            yield batch


def _is_text(head: bytes) -> bool:
    if head[:2] in _UTF_16:
        return True
    text = head.decode("utf-8", "replace").rstrip("\ufffd")  # the last character may be cut
    return (bool(text) or not head) and "\ufffd" not in text and not _NO_TEXT.intersection(head)


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


def of_bus(
    reader: Reader, batches: Iterable[tuple[Interface, Batch]], on_interface: Callable[[Interface], None]
) -> Iterator[Batch]:
    """The ``batches`` of PROFIBUS that come from ``reader``. Raises CaptureFileError."""
    last = None
    for interface, batch in batches:
        if interface is not last:
            if interface.linktype not in (USER0, PROFIBUS_DL):
                raise CaptureFileError(
                    f"{reader.name}: packets of link type {interface.linktype}, "
                    f"PROFIBUS has {USER0} (USER0) or {PROFIBUS_DL}"
                )
            last = interface
            on_interface(interface)
        yield batch
    if reader.cut:
        raise CaptureFileError(f"{reader.name}: the file ends within a block: {reader.cut}")


def _lines(file: _Again, head: bytes, name: str, on_unread: Callable[[Unread], None] | None) -> Iterator[Transmission]:
    unread = 0

    def report(line: Unread) -> None:
        nonlocal unread
        unread += 1
        if on_unread is None:
            raise CaptureFileError(f"{name}: line {line.number}: {line.reason or 'no octets'}")
        on_unread(line)

    reader = LogReader(report)
    decoder = codecs.getincrementaldecoder("utf-16" if head[:2] in _UTF_16 else "utf-8")(errors="replace")
    rest, number, found = "", 0, 0
    while True:
        octets = file.read(1 << 16)
        *lines, rest = (rest + decoder.decode(octets, not octets)).split("\n")
        if not octets:
            lines, rest = [rest], ""
        number += len(lines)
        if len(rest) > _MOST_LINE:
            raise CaptureFileError(f"{name}: line {number + 1} has more than {_MOST_LINE} characters")
        for line in lines:
            for one in reader.add(line):
                found += 1
                yield one
        if not octets:
            break
    for one in reader.end():
        found += 1
        yield one
    if not found:
        what = "no octets in its lines; they are written as in 68 05 05 68" if unread else "nothing but blanks"
        raise CaptureFileError(f"{name}: {what}")
