"""The truth for the fault matrix: the octets on the wire, and the data that devices and applications got.

The wire is read from its log by the places of octets: nothing of the codec, of the decoder or of the state machines is
used. The two ends put data on the bus that exist only once (:class:`Device` and :class:`Application`), so every octet
that arrives can be held against the one place where it came from.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from bus_kit import IDENT, PPO1
from faults.counting_plugin import CountingPlugin

from dpstack.dp.slave.device import DpV0Device, Leave
from dpstack.trace import WireEntry
from dpstack.units import bits_to_ns

#: senders of octets that are a fault and no station
FAULTY = "fault"
T_SYN_BITS = 33
SD1, SD2, TOKEN = 0x10, 0x68, 0xDC
REQUEST, FCV, FUNCTION = 0x40, 0x10, 0x0F
#: SRD low and high
SRD = (0x0C, 0x0D)
EXTENSION = 0x80
BROADCAST = 127
SAP_GLOBAL_CONTROL = 58
CLEAR = b"\x02\x00"
ZEROS = bytes(12)
NEVER_LIVE = "never live"


def fields(octets: bytes) -> tuple[int, int, int, int | None, bytes] | None:
    """DA, SA, FC, DSAP and data of a telegram with a sound head, by the places of its octets; else None."""
    if not octets:
        return None
    if octets[0] == SD1 and len(octets) == 6:
        return octets[1], octets[2], octets[3], None, b""
    if octets[0] != SD2 or len(octets) < 9 or octets[1] != octets[2] or len(octets) != octets[1] + 6:
        return None
    da, sa, data = octets[4], octets[5], octets[7:-2]
    if da & EXTENSION:
        return da & 127, sa & 127, octets[6], data[0], data[2:] if sa & EXTENSION else data[1:]
    return da, sa & 127, octets[6], None, data


class Device(DpV0Device):
    """A slave's device of twelve octets each way. Every exchange returns inputs that never were before.

    ``given``: by inputs the outputs for which they were returned, and when. ``taken``: the outputs with their times,
    and whether the last Global_Control was Clear: then the slave gives zeros in place of outputs.
    """

    ident = IDENT
    name = "truth"
    configs = (PPO1,)

    def __init__(self, address: int, mark: int = 0xA0) -> None:
        self._head = bytes((mark, address, 0x68, 0xE5))
        self.given: dict[bytes, tuple[bytes, int]] = {}
        self.taken: list[tuple[int, bytes, bool]] = []
        self._cleared = True
        #: the reason why the outputs of now are safe; None while they are live
        self.safe_by: str | None = NEVER_LIVE
        self.safe_at = 0
        self.live_at = -1

    def exchange(self, outputs: bytes, now: int) -> bytes:
        self.taken.append((now, outputs, self._cleared))
        if outputs != ZEROS:
            self.safe_by = None
            self.live_at = now
        else:
            self._safe("zeros", now)
        count = len(self.given).to_bytes(4, "big")
        inputs = self._head + count + bytes(255 - octet for octet in count)
        self.given[inputs] = outputs, now
        return inputs

    def clear(self, now: int) -> None:
        self._cleared = True
        self._safe("Clear", now)

    def operate(self, now: int) -> None:
        self._cleared = False

    def leave(self, reason: Leave, now: int) -> None:
        self._cleared = True
        self._safe(reason.value, now)

    def _safe(self, by: str, now: int) -> None:
        if self.safe_by is None:
            self.safe_by, self.safe_at = by, now


@dataclass
class Application(CountingPlugin):
    """The program's end of one slave: every call gives outputs that never were before.

    ``calls``: time, inputs that it got, outputs that it returned.
    """

    calls: list[tuple[int, bytes, bytes]] = field(default_factory=list)

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        outputs = self.next_outputs()
        self.calls.append((now, inputs, outputs))
        return outputs


@dataclass
class Attempt:
    """One request to a slave on the wire, and the silence or answer after it."""

    start_ns: int
    end_ns: int
    octets: bytes
    touched: bool


@dataclass
class Truth:
    """The log of one wire. ``watch``: called with every transmission as it ends. ``away``: by address, the times in
    which the slave could not answer because of a fault."""

    baud: int
    #: by their begin: the telegrams of which only the first octets were on the wire
    meant: dict[int, bytes] = field(default_factory=dict)
    entries: list[WireEntry] = field(default_factory=list)
    watch: list[Callable[[WireEntry], None]] = field(default_factory=list)
    away: dict[int, list[tuple[int, int]]] = field(default_factory=dict)

    def __call__(self, entry: WireEntry) -> None:
        self.entries.append(entry)
        for watcher in tuple(self.watch):
            watcher(entry)

    def since(self, at_ns: int) -> Iterator[WireEntry]:
        return (entry for entry in self.entries if entry.end_ns >= at_ns)

    # --- data ----------------------------------------------------------------------------------------------------

    def wrong_outputs(self, device: Device, address: int) -> int:
        """Number of times that the device got outputs that no master had put on the wire for it last."""
        sent = [
            (entry.end_ns, data)
            for entry in self.entries
            for da, _, fc, dsap, data in [fields(entry.octets) or (-1, 0, 0, None, b"")]
            if da == address and dsap is None and fc & REQUEST and fc & FUNCTION in SRD
        ]
        sent.sort()
        wrong, at, last = 0, 0, b""
        for now, outputs, cleared in device.taken:
            while at < len(sent) and sent[at][0] <= now:
                last = sent[at][1]
                at += 1
            wrong += outputs != last and not (cleared and outputs == ZEROS)
        return wrong

    def wrong_inputs(self, application: Application, devices: list[Device]) -> int:
        """Number of inputs at the application that are not the answer to its last outputs: never on the wire, of
        another exchange, or older than those before. ``devices``: all that have its slave's address."""
        answers = {
            data
            for entry in self.entries
            for _, sa, fc, dsap, data in [fields(entry.octets) or (0, -1, 0, None, b"")]
            if sa == application.address and dsap is None and not fc & REQUEST
        }
        wrong, before, asked, asked_at = 0, b"", b"", 0
        for now, inputs, outputs in application.calls:
            if inputs and inputs != before:
                given = next((device.given[inputs] for device in devices if inputs in device.given), None)
                sound = given is not None and inputs in answers and given[1] >= asked_at and given[0] in (asked, ZEROS)
                wrong += not sound
            before, asked, asked_at = inputs, outputs, now
        return wrong

    # --- attempts ------------------------------------------------------------------------------------------------

    def retries(self, since_ns: int) -> int:
        """Requests with a valid FCB that are the same as the last one to their station: repetitions."""
        found, last = 0, dict[tuple[str | None, int], bytes]()
        for entry in self.entries:
            parts = fields(entry.octets)
            if parts is None or not parts[2] & REQUEST or entry.sender == FAULTY or "repeated" in entry.note:
                continue
            pair = entry.sender, parts[0]
            if parts[2] & FCV and last.get(pair) == entry.octets and entry.start_ns >= since_ns:
                found += 1
            last[pair] = entry.octets
        return found

    def attempts(self, address: int, until_ns: int, count: int) -> list[Attempt]:
        """The last ``count`` requests to ``address`` before ``until_ns`` that want an answer, oldest first."""
        quiet = bits_to_ns(T_SYN_BITS, self.baud)
        found: deque[Attempt] = deque()
        end_ns = until_ns
        for place in range(len(self.entries) - 1, -1, -1):
            entry = self.entries[place]
            if entry.start_ns >= until_ns or entry.sender == FAULTY or "repeated" in entry.note:
                continue
            parts = fields(self.meant.get(entry.start_ns, entry.octets))
            if entry.octets[:1] == bytes((TOKEN,)):
                end_ns = entry.start_ns
            elif parts is not None and parts[2] & REQUEST:
                if parts[0] == address:
                    touched = self._touched(address, entry.start_ns - quiet, end_ns, place)
                    found.appendleft(Attempt(entry.start_ns, end_ns, entry.octets, touched))
                end_ns = entry.start_ns
            if len(found) == count:
                break
        return list(found)

    def _touched(self, address: int, start_ns: int, end_ns: int, place: int) -> bool:
        """Whether a fault acted on the wire, or on the slave, from ``start_ns`` to ``end_ns``."""
        if any(begin < end_ns and end > start_ns for begin, end in self.away.get(address, ())):
            return True
        nearby = self.entries[max(0, place - 20) : place + 20]
        faults = (entry for entry in nearby if entry.note or entry.sender == FAULTY)
        return any(entry.start_ns < end_ns and entry.end_ns > start_ns for entry in faults)

    def unasked_ns(self, address: int, until_ns: int, back_ns: int) -> int:
        """The longest time within ``back_ns`` before ``until_ns`` without an intact request to ``address``."""
        since = until_ns - back_ns
        longest, last = 0, since
        for entry in self.entries:
            if entry.end_ns < since or entry.note or entry.sender == FAULTY:
                continue
            if entry.end_ns > until_ns:
                break
            parts = fields(entry.octets)
            if parts is not None and parts[0] == address and parts[2] & REQUEST:
                longest = max(longest, entry.end_ns - last)
                last = entry.end_ns
        return max(longest, until_ns - last)

    # --- the end -------------------------------------------------------------------------------------------------

    def last_octets(self, address: int) -> str:
        """The last outputs that were put on the wire for the slave, and the Clear after its last live ones."""
        data, clears = "nothing", 0
        for entry in self.entries:
            parts = fields(entry.octets)
            if parts is None or not parts[2] & REQUEST or entry.sender == FAULTY:
                continue
            da, _, _, dsap, unit = parts
            if da == address and dsap is None and parts[2] & FUNCTION in SRD:
                data = "live" if any(unit) else "zeros"
                clears = 0 if data == "live" else clears
            elif da == BROADCAST and dsap == SAP_GLOBAL_CONTROL:
                clears = clears + 1 if unit == CLEAR else 0
        return f"{data}, Clear x {min(clears, 2)}"
