"""Files that are decoded or judged: opening them, and the transmissions in them. A port is never opened as a file."""

from __future__ import annotations

import codecs
import os
import stat
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, BinaryIO, Final

from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import CaptureFileError, UsageError
from dpstack.text import runs_of, shortened
from dpstack.units import AUTO

if TYPE_CHECKING:
    from dpstack.capture.pcapng import Interface
    from dpstack.capture.transmission import Transmission
    from dpstack.decode.log_text import Unread

#: standard input
STDIN: Final = "-"


def is_growing(name: str) -> bool:
    """Whether ``name`` may deliver its octets slowly: standard input, a pipe."""
    try:
        return name == STDIN or not stat.S_ISREG(os.stat(name).st_mode)
    except (OSError, ValueError):
        return False


def add_channel(parser: Parser) -> None:
    """The option ``--channel`` of a waveform."""
    parser.value(
        "--channel", "NAME", "the channel of a logic analyser's file with the bus (default: finds it)", default=""
    )


def transmissions_of(
    name: str,
    on_interface: Callable[[Interface], None] = lambda interface: None,
    *,
    on_unread: Callable[[Unread], None] | None = None,
    baud: int | str = AUTO,
    channel: str = "",
    on_remark: Callable[[str], None] = output.warn,
) -> Iterator[Transmission]:
    """The transmissions in the file ``name``, or in standard input, see :func:`read_transmissions`. Remarks about a
    waveform go to ``on_remark``.

    Raises UsageError if it cannot be opened; a device is refused, because opening a port switches its lines.
    """
    from dpstack.decode.source import read_transmissions  # here, as octets on the command line are no file

    to_close = None if name == STDIN else _opened(name)
    try:
        file, title = (sys.stdin.buffer, "standard input") if to_close is None else (to_close, name)
        rate = 0 if isinstance(baud, str) else baud
        yield from read_transmissions(
            file, title, on_interface, on_unread=on_unread, baud=rate, channel=channel, on_remark=on_remark
        )
    except OSError as error:
        raise CaptureFileError(f"{name}: cannot be read to its end ({error.strerror})") from None
    finally:
        if to_close is not None:
            to_close.close()


def bus_in(
    name: str,
    on_interface: Callable[[Interface], None],
    *,
    on_unread: Callable[[Unread], None] | None = None,
    baud: int | str = AUTO,
    channel: str = "",
    on_remark: Callable[[str], None] = output.warn,
) -> Iterator[Transmission]:
    """The transmissions of one bus in the file ``name``: those of its first port. ``baud``: the rate if the file does
    not say it. ``on_remark`` gets the names of other ports, and remarks about a waveform.

    Raises UsageError if neither does, and as :func:`transmissions_of`.
    """
    port: str | None = None
    elsewhere = False
    left_out: set[str] = set()

    def choose(interface: Interface) -> None:
        nonlocal port, elsewhere
        if port is None:
            port = interface.name
        elsewhere = interface.name != port
        if not elsewhere:
            on_interface(interface)
        elif interface.name not in left_out:
            left_out.add(interface.name)
            on_remark(f"{name}: only the port {port!r} is read; left out: {interface.name!r}")

    for one in transmissions_of(name, choose, on_unread=on_unread, baud=baud, channel=channel, on_remark=on_remark):
        if elsewhere:
            continue
        if one.baud:
            yield one
        elif isinstance(baud, str):
            raise UsageError(f"{name}: the file does not say the rate of its bus; give it, for instance --baud 500000")
        else:
            yield one._replace(baud=baud)


def _opened(name: str) -> BinaryIO:
    try:
        mode = os.stat(name).st_mode
        if stat.S_ISDIR(mode):
            raise UsageError(f"{name}: is a directory; name a capture file in it")
        if stat.S_ISCHR(mode) or stat.S_ISBLK(mode):
            raise UsageError(f"{name}: is a device; to listen to a port: dpstack capture --port {name}")
        return open(name, "rb")
    except ValueError as error:  # a name with a zero octet
        raise UsageError(f"{name}: {error}; name a capture file") from None
    except OSError as error:
        raise UsageError(f"{name}: cannot be read ({error.strerror}); name a capture file") from None


#: octets of a pasted text that is no capture
_MOST_TEXT: Final = 1 << 20
#: lines that were not understood and are named one by one
_NAMED: Final = 20


def text_of(name: str) -> str:
    """The text in the file ``name``, or in standard input. Raises UsageError if it cannot be read."""
    if name == STDIN:
        octets = sys.stdin.buffer.read(_MOST_TEXT)
    else:
        with _opened(name) as file:
            octets = file.read(_MOST_TEXT)
    return octets.decode("utf-16" if octets[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE) else "utf-8", "replace")


class UnreadLines:
    """Lines of a log without octets: each is shown at its place (``shown``), and all are counted at the end."""

    def __init__(self, *, shown: bool) -> None:
        self._shown = shown
        self._words: list[int] = []
        self._wrong: list[Unread] = []

    def add(self, line: Unread) -> None:
        if line.reason:
            self._wrong.append(line)
        else:
            self._words.append(line.number)
        if self._shown:
            output.line(f"        line {line.number}: {line.text}", "dim")

    def report(self) -> bool:
        """Say which lines they are, on standard error. True if one seems to have octets that were not understood."""
        if self._words:
            count = len(self._words)
            numbers = ", ".join(str(a) if a == b else f"{a} to {b}" for a, b in runs_of(self._words))
            output.warn(f"{count} line{'s' * (count > 1)} without octets: {numbers}")
        for line in self._wrong[:_NAMED]:
            output.warn(f"line {line.number} was not understood: {line.reason}: {shortened(line.text, 200)}")
        if len(self._wrong) > _NAMED:
            rest = ", ".join(str(line.number) for line in self._wrong[_NAMED:])
            output.warn(f"{len(self._wrong) - _NAMED} more lines were not understood: {rest}")
        return bool(self._wrong)
