"""Cuts a stream of octets into transmissions: whole telegrams, and the octets between them.

Real ports show neither idle times nor gaps between characters, so a telegram ends where its length says so. Within the
length that a damaged telegram claims, only telegrams with a check sequence count: an octet E5 among its data is no
acknowledgement (the same rule as in :mod:`dpstack.fdl.decoder`).
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import Final

from dpstack.capture.transmission import Damage, Transmission
from dpstack.fdl.codec import Flaw, claimed, decode, parse
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.phy.marked import PACKET_NOTE, MarkedOctets
from dpstack.units import NEVER, chars_to_ns

#: Octets that are no telegram are kept together up to this number: the longest telegram has 255.
_MOST_HELD: Final = 1024
_LONGEST_TELEGRAM: Final = 255
#: marked octets that a note names
_SHOWN: Final = 4
#: first octets of telegrams with a check sequence
_CHECKED: Final = frozenset((int(Kind.SD1), int(Kind.SD2), int(Kind.SD3)))
_NEW = tuple.__new__  # the constructor of a NamedTuple takes twice as long
#: for octets without times
_ANY_BAUD: Final = 9600
#: the damage of octets at which a telegram with this flaw begins
DAMAGE_OF: Final = {
    Flaw.BAD_FCS: Damage.FCS,
    Flaw.BAD_ED: Damage.FCS,
    Flaw.BAD_ADDRESS: Damage.FCS,
    Flaw.BAD_EXTENSION: Damage.FCS,
    Flaw.BAD_FC: Damage.FCS,
    Flaw.BAD_START: Damage.START_DELIMITER,
    Flaw.LE_MISMATCH: Damage.START_DELIMITER,
    Flaw.LE_RANGE: Damage.START_DELIMITER,
    Flaw.BAD_SECOND_SD: Damage.START_DELIMITER,
}


class Cutter:
    """Cuts the octets of one line at ``baud``. A telegram whose rest does not come within ``stall_ns`` is given up.

    The times of :meth:`feed` are arrival times: the last octet of a chunk was on the line no later. Telegrams that
    arrive together in one chunk get times without gaps between them, counted back from its arrival. The times of
    transmissions are those plus ``epoch_ns``; they never run backwards, whatever the arrival times do. Octets that the
    port has marked as damaged (:class:`MarkedOctets`) stay at their place: the transmission is damaged, a note says
    where (``marked``: by whom). At most 1279 octets are held from one call to the next.
    """

    def __init__(self, baud: int, stall_ns: int, epoch_ns: int = 0, marked: str = "by mark of the port") -> None:
        self.baud = baud
        self._marked_by = marked
        self.stall_ns = stall_ns
        self._epoch_ns = epoch_ns
        self._held = bytearray()
        self._cut = 0  # number of octets cut off so far: the position of the first held one in the stream
        self._arrivals: deque[tuple[int, int]] = deque()  # of chunks: position of their end, time
        self._marks: deque[tuple[int, bool]] = deque()  # of damaged octets: position in the stream, of a whole packet
        self._last_ns = 0  # arrival of the last chunk
        self._begun = 0  # where the octets begin that are no telegram, in _held
        self._at = 0  # where the next telegram may begin, in _held
        self._doubt = 0  # end of the length that a damaged telegram claims, in _held
        self._free_ns = 0  # end of the last transmission
        self._chars_ns = [chars_to_ns(count, baud) for count in range(_LONGEST_TELEGRAM + 1)]

    def feed(self, chunk: bytes, now: int) -> list[Transmission]:
        """The transmissions that end within ``chunk``, which arrived at ``now`` (ns)."""
        size = len(chunk)
        if type(chunk) is MarkedOctets:
            begin = self._cut + len(self._held)
            self._marks += [(begin + place, chunk.packets) for place in chunk.marks]
        elif not self._held and not self._doubt and size <= _LONGEST_TELEGRAM and decode(chunk) is not None:
            # the fast path: one chunk, one telegram
            start = now - self._chars_ns[size]
            if start < self._free_ns:
                start = self._free_ns
            if now > start:
                self._free_ns = now
            return [_NEW(Transmission, (chunk, start + self._epoch_ns, self.baud, "", 0))]
        if not size:
            return []
        given_up = list(self._scan(at_end=True)) if self._is_late(chunk, now) else []
        self._held += chunk
        self._last_ns = now
        self._arrivals.append((self._cut + len(self._held), now))
        given_up += self._scan(at_end=False)
        return given_up

    def _is_late(self, chunk: bytes, now: int) -> bool:
        """Whether the line was silent for too long before ``chunk`` and its octets do not continue those held.

        A telegram with a check sequence may be continued late: then this computer was late, not the line.
        """
        if not self._held and not self._doubt:
            return False
        if now - chars_to_ns(len(chunk), self.baud) <= self._last_ns + self.stall_ns:
            return False
        octets = bytes(self._held[self._at :]) + chunk[:_LONGEST_TELEGRAM]
        found = parse(octets, 0, len(octets))
        return not (isinstance(found, Telegram) and octets[0] in _CHECKED)

    def stall_at(self) -> int:
        """When the octets held count as no telegram, in ns; NEVER if none are held."""
        return self._last_ns + self.stall_ns if self._held or self._doubt else NEVER

    def give_up(self) -> list[Transmission]:
        """The line was silent: the transmissions among the octets held, none of which waits for more."""
        return list(self._scan(at_end=True))

    def _scan(self, *, at_end: bool) -> Iterator[Transmission]:
        held = self._held
        end = len(held)
        while self._at < end:
            at = self._at
            found = parse(held, at, end)
            if found is None and not at_end:
                break
            if isinstance(found, Telegram) and (held[at] in _CHECKED or at >= self._doubt):
                yield from self._no_telegram(at)
                size = claimed(held, at, end)
                yield self._piece(at, at + size, 0)
                self._begun = self._doubt = self._at = at + size
                continue
            if at >= self._doubt and found is not Flaw.BAD_START:
                self._doubt = at + claimed(held, at, end)
            self._at += 1
            if self._at - self._begun >= _MOST_HELD:
                yield from self._no_telegram(self._at)
        if at_end:
            yield from self._no_telegram(end)
            self._doubt = 0
        self._drop()

    def _no_telegram(self, stop: int) -> Iterator[Transmission]:
        """The octets up to ``stop`` that belong to no telegram, if there are any."""
        begun = self._begun
        if begun < stop:
            found = parse(self._held, begun, stop)
            damage = DAMAGE_OF[found] if isinstance(found, Flaw) else Damage.TOO_SHORT
            yield self._piece(begun, stop, damage)
            self._begun = stop

    def _piece(self, begin: int, stop: int, damage: int) -> Transmission:
        position = self._cut + stop
        arrivals = self._arrivals
        while arrivals[0][0] < position:
            arrivals.popleft()
        after, arrival = arrivals[0]
        end_ns = arrival - chars_to_ns(after - position, self.baud)
        start_ns = max(end_ns - chars_to_ns(stop - begin, self.baud), self._free_ns)
        self._free_ns = max(end_ns, start_ns)
        one = _NEW(Transmission, (bytes(self._held[begin:stop]), start_ns + self._epoch_ns, self.baud, "", damage))
        return self._marked(one, position) if self._marks and self._marks[0][0] < position else one

    def _marked(self, one: Transmission, position: int) -> Transmission:
        """``one``, which ends at ``position`` in the stream, with the damage that the port has marked."""
        marks = self._marks
        places: list[int] = []
        packets = False
        while marks and marks[0][0] < position:
            place, of_packet = marks.popleft()
            places.append(place - position + len(one.octets))
            packets |= of_packet
        checked = not one.damage and one.octets[0] in _CHECKED
        if packets and checked:  # its check sequence shows that the damaged octet is another one
            return one._replace(note=PACKET_NOTE)
        note = f"damaged {self._marked_by}: {_places(places)}"
        if packets:
            note += f"; {PACKET_NOTE}"
        return one._replace(note=note, damage=one.damage | Damage.PARITY_OR_FRAMING)

    def _drop(self) -> None:
        """Forget the octets that were cut off."""
        size = self._begun
        del self._held[:size]
        self._cut += size
        self._begun = 0
        self._at -= size
        self._doubt = max(0, self._doubt - size)
        if not self._held:
            self._arrivals.clear()


def _places(places: list[int]) -> str:
    """Octets of a telegram in words, counted from 1: the first four."""
    shown = ", ".join(str(place + 1) for place in places[:_SHOWN])
    more = f" and {len(places) - _SHOWN} more" if len(places) > _SHOWN else ""
    return f"octet{'s' if len(places) > 1 else ''} {shown}{more}"


def split(octets: bytes) -> list[bytes]:
    """The telegrams in ``octets`` one by one, and between them the octets of no telegram."""
    cutter = Cutter(_ANY_BAUD, 0)
    return [piece.octets for piece in (*cutter.feed(octets, 0), *cutter.give_up())]
