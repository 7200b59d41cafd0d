"""The octets on the line of a running program, for the clients of its control socket.

The machine of the program only fills a bounded ring (:mod:`dpstack.drivers.tap`). The feed empties it beside the bus,
in small portions, encodes each portion once, and writes it to all its clients. Nothing waits for a client: one that
does not read in time loses portions, and learns their number in the place of the gap. A listener within the program
gets the entries as they are.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Mapping
from time import monotonic_ns, time_ns
from typing import Final, Protocol

from dpstack.api.control.control_server import LongCommand, Sender
from dpstack.drivers.tap import TAP_PAUSE_NS, TAP_PORTION, TAP_SHORT_PAUSE_NS, Tap, Tapped
from dpstack.text import json_text
from dpstack.units import ns_to_s

#: a client gets an empty portion after this time on a silent line: a sign of life
_SIGN_OF_LIFE_S: Final = 1.0
#: a client that reads nothing for this many signs of life is disconnected
_PATIENCE: Final = 60
#: octets of the entries in a line; many programs read lines of up to 64 KB
_LONGEST_LINE: Final = 60_000


class _Reader:
    """One client. ``lost``: entries that it has not got since its last line."""

    def __init__(self, sender: Sender) -> None:
        self.sender = sender
        self.lost = 0
        self.served = False  # it got a line since the last sign of life was due

    def put(self, lost: int, octets: bytes, count: int) -> None:
        """Send a portion of ``count`` entries, before which ``lost`` were lost; ``octets``: the entries as JSON."""
        self.lost += lost
        if self.sender.offer(b'{"item":{"lost":%d,"octets":%s}}\n' % (self.lost, octets)):
            self.lost = 0
            self.served = True
        else:
            self.lost += count


class TapListener(Protocol):
    """A listener within the program. Both methods return at once."""

    def describe(self, epoch_ns: int, about: Mapping[str, object]) -> None:
        """The line is as ``about`` says; ``epoch_ns`` plus the time of an entry is the time since 1970."""

    def put(self, lost: int, entries: list[Tapped]) -> None:
        """The next entries, before which ``lost`` are missing."""


class TapFeed:
    """``attach`` connects a tap to the program's line, or ends it with None; ``now`` is the time of its entries in ns;
    ``about`` describes the line: ``baud`` (None: it is searched for, and nothing is tapped), ``paced``."""

    def __init__(
        self,
        attach: Callable[[Tap | None], None],
        now: Callable[[], int],
        about: Callable[[], Mapping[str, object]],
    ) -> None:
        self._attach = attach
        self._now = now
        self._about = about
        self._tap = Tap()
        self._attached = False
        self._readers: set[_Reader] = set()
        self._listeners: list[TapListener] = []
        self._timer: asyncio.TimerHandle | None = None

    def handler(self, _args: list[str]) -> LongCommand:
        """The command ``tap``: items until the client closes the connection.

        The first one describes the line, again when its rate was searched and found; ``epoch_ns`` plus the time of an
        entry is the time since 1970. The others have ``octets``, a list of [time, rate, octets in hex, sent by the
        program itself], and ``lost``, the number of entries that are missing directly before them. An entry without
        octets: the program has lost its port (rate 0), or has it back.
        """
        return self._feed

    async def _feed(self, sender: Sender) -> object:
        reader = _Reader(sender)
        unread = deaf = 0
        try:
            self._join(reader)
            while True:
                await asyncio.sleep(_SIGN_OF_LIFE_S)
                sender.check()
                deaf = deaf + 1 if sender.unread >= unread > 0 else 0
                unread = sender.unread
                if deaf >= _PATIENCE:
                    sender.give_up()
                if not reader.served:
                    reader.put(0, b"[]", 0)
                reader.served = False
        finally:
            self._leave(reader)

    def add_listener(self, listener: TapListener) -> None:
        """Hand the entries to ``listener`` from now on."""
        first = not self._is_followed
        self._listeners.append(listener)
        self._begin(first, [], [listener])

    def remove_listener(self, listener: TapListener) -> None:
        """End it; ``listener`` gets all entries up to now first."""
        self._hand_out(all_of_it=True)
        self._listeners.remove(listener)
        self._end_unless_followed()

    @property
    def _is_followed(self) -> bool:
        return bool(self._readers or self._listeners)

    def _join(self, reader: _Reader) -> None:
        first = not self._is_followed
        self._readers.add(reader)
        self._begin(first, [reader], [])

    def _begin(self, first: bool, readers: list[_Reader], listeners: list[TapListener]) -> None:
        if first:
            self._tap = Tap()
        about = self._about()
        self._describe(about, readers, listeners)
        if first:
            self._follow_search(about)
            self._set_timer(TAP_PAUSE_NS)

    def _leave(self, reader: _Reader) -> None:
        """The last octets go to the client, too, if the program ends."""
        self._hand_out(all_of_it=True)
        self._readers.discard(reader)
        self._end_unless_followed()

    def _end_unless_followed(self) -> None:
        if self._is_followed:
            return
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if self._attached:
            self._attached = False
            self._attach(None)

    def _describe(self, about: Mapping[str, object], readers: list[_Reader], listeners: list[TapListener]) -> None:
        epoch_ns = time_ns() - (monotonic_ns() if about["baud"] is None else self._now())
        for listener in listeners:
            listener.describe(epoch_ns, about)
        if readers:
            line = json_text({"item": {"epoch_ns": epoch_ns, **about}}).encode() + b"\n"
            for reader in readers:
                reader.sender.offer(line)

    def _follow_search(self, about: Mapping[str, object]) -> bool:
        """Tap the line while its rate is known. Returns whether that has changed."""
        known = about["baud"] is not None
        if known is self._attached:
            return False
        self._attached = known
        if known:
            self._tap = Tap()
            loop = asyncio.get_running_loop()
            self._tap.on_portion = lambda: loop.call_soon(self._hand_out)  # not in the middle of the driver's work
        self._attach(self._tap if known else None)
        return True

    def _tick(self) -> None:
        try:
            about = self._about()
            if self._follow_search(about):
                self._describe(about, list(self._readers), self._listeners)
            else:
                self._hand_out()
        finally:
            self._set_timer(TAP_SHORT_PAUSE_NS if self._tap.waiting else TAP_PAUSE_NS)

    def _set_timer(self, pause_ns: int) -> None:
        self._timer = asyncio.get_running_loop().call_later(ns_to_s(pause_ns), self._tick)

    def _hand_out(self, *, all_of_it: bool = False) -> None:
        """Hand a portion to each client, or all there is."""
        while self._attached and self._tap.waiting:
            lost, entries = self._tap.take(TAP_PORTION)
            for listener in self._listeners:
                listener.put(lost, entries)
            if self._readers:
                self._put(lost, entries)
            if not all_of_it:
                return

    def _put(self, lost: int, entries: list[Tapped]) -> None:
        """Send ``entries`` to all clients, in one line unless it would be too long."""
        octets = _encoded(entries)
        half = len(entries) // 2
        if half and len(octets) > _LONGEST_LINE:
            self._put(lost, entries[:half])
            self._put(0, entries[half:])
            return
        for reader in self._readers:
            reader.put(lost, octets, len(entries))


def _encoded(entries: list[Tapped]) -> bytes:
    import msgspec  # here, as most programs are never tapped

    return msgspec.json.encode([(end_ns, baud, octets.hex(), sent) for end_ns, baud, octets, sent in entries])
