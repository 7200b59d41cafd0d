"""Files that are decoded or judged: opening them, and the transmissions in them. A port is never opened as a file."""

from __future__ import annotations

import codecs
import os
import stat
import sys
from collections.abc import Callable, Iterator, Sequence
from itertools import chain
from typing import TYPE_CHECKING, BinaryIO, Final

from msgspec.structs import replace

from dpstack.cli.parser import Parser
from dpstack.cli.terminal import output
from dpstack.errors import CaptureFileError, UsageError
from dpstack.text import runs_of, shortened
from dpstack.units import AUTO

if TYPE_CHECKING:
    from dpstack.capture.pcapng import Interface
    from dpstack.capture.transmission import Columns, Transmission
    from dpstack.cli.listening.file_jobs import FileJobs
    from dpstack.decode.log_text import Unread
    from dpstack.monitor.exchanges import Batch

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
    return chain.from_iterable(
        batches_of(name, on_interface, on_unread=on_unread, baud=baud, channel=channel, on_remark=on_remark)
    )


def batches_of(
    name: str,
    on_interface: Callable[[Interface], None] = lambda interface: None,
    *,
    on_unread: Callable[[Unread], None] | None = None,
    baud: int | str = AUTO,
    channel: str = "",
    on_remark: Callable[[str], None] = output.warn,
    on_octets: Callable[[int], None] = lambda octets: None,
) -> Iterator[Columns | Sequence[Transmission]]:
    """The same as :func:`transmissions_of`, in pieces as the file delivers them, see :func:`read_batches`.
    ``on_octets`` gets the number of octets that were read of a file."""
    from dpstack.decode.source import read_batches  # here, as octets on the command line are no file

    to_close = None if name == STDIN else opened(name)
    try:
        file, title = (sys.stdin.buffer, "standard input") if to_close is None else (to_close, name)
        rate = 0 if isinstance(baud, str) else baud
        seekable = to_close is not None and to_close.seekable()
        for batch in read_batches(
            file, title, on_interface, on_unread=on_unread, baud=rate, channel=channel, on_remark=on_remark
        ):
            if seekable:
                on_octets(file.tell())
            yield batch
    except OSError as error:
        raise _end_of(name, error) from None
    finally:
        if to_close is not None:
            to_close.close()


def _end_of(name: str, error: OSError) -> CaptureFileError:
    return CaptureFileError(f"{name}: cannot be read to its end ({error.strerror})")


def bus_in(
    name: str,
    on_interface: Callable[[Interface], None],
    *,
    port: str | None = None,
    on_unread: Callable[[Unread], None] | None = None,
    baud: int | str = AUTO,
    channel: str = "",
    on_remark: Callable[[str], None] = output.warn,
    on_octets: Callable[[int], None] = lambda octets: None,
) -> Iterator[Batch]:
    """The transmissions of one bus in the file ``name``, in pieces as the file delivers them: those of ``port``
    (default: its first one). ``baud``: the rate if the file does not say it. ``on_remark`` gets the names of other
    ports, and remarks about a waveform.

    Raises UsageError if neither does, and as :func:`transmissions_of`.
    """
    chosen = _OnePort(name, on_interface, port, on_remark)
    for batch in batches_of(
        name,
        chosen.choose,
        on_unread=on_unread,
        baud=baud,
        channel=channel,
        on_remark=on_remark,
        on_octets=on_octets,
    ):
        if chosen.elsewhere:
            continue
        yield _at_rate(name, batch, baud)


def bus_by_jobs(
    jobs: FileJobs,
    name: str,
    on_interface: Callable[[Interface], None],
    port: str | None,
    baud: int | str,
    on_remark: Callable[[str], None],
    on_octets: Callable[[int], None],
) -> Iterator[Batch]:
    """The same of a pcapng file that ``jobs`` read."""
    chosen = _OnePort(name, on_interface, port, on_remark)
    try:
        with opened(name) as file:
            for batch in jobs.batches(file, name, chosen.choose):
                on_octets(file.tell())
                if chosen.elsewhere:
                    continue
                yield _at_rate(name, batch, baud)
    except OSError as error:
        raise _end_of(name, error) from None


class _OnePort:
    """Chooses one port of the file ``name``: ``port``, or the first one. ``on_interface`` gets its interfaces,
    ``on_remark`` the names of other ports."""

    def __init__(
        self,
        name: str,
        on_interface: Callable[[Interface], None],
        port: str | None,
        on_remark: Callable[[str], None],
    ) -> None:
        #: the transmissions that follow are of another port
        self.elsewhere = False
        self._name = name
        self._on_interface = on_interface
        self._port = port
        self._on_remark = on_remark
        self._left_out: set[str] = set()

    def choose(self, interface: Interface) -> None:
        """The next transmissions are of ``interface``."""
        if self._port is None:
            self._port = interface.name
        self.elsewhere = interface.name != self._port
        if not self.elsewhere:
            self._on_interface(interface)
        elif interface.name not in self._left_out:
            self._left_out.add(interface.name)
            self._on_remark(f"{self._name}: only the port {self._port!r} is read; left out: {interface.name!r}")


def _at_rate(name: str, batch: Batch, baud: int | str) -> Batch:
    """A batch of one interface with the rate of the bus: ``baud``, if the file does not say it."""
    if isinstance(batch, Sequence):
        return batch if batch[0].baud else [one._replace(baud=_rate_of(name, baud)) for one in batch]
    return batch if batch.baud else replace(batch, baud=_rate_of(name, baud))


def _rate_of(name: str, baud: int | str) -> int:
    """The rate of a bus of which the file does not say it: ``baud``. Raises UsageError for "auto"."""
    if isinstance(baud, str):
        raise UsageError(f"{name}: the file does not say the rate of its bus; give it, for instance --baud 500000")
    return baud


def opened(name: str) -> BinaryIO:
    if not name:
        raise UsageError("the name of the file is empty; name a capture file")
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
        with opened(name) as file:
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
