"""A wire with DP slaves behind the port of a master: octets and their times on the wire, in whole ns.

The slaves know telegrams as numbers only; nothing of the project is used to read or to make them. They keep the rules
that a slave's chip keeps: a request begins after 33 bits of silence, its frame count bit, its watchdog, its lock.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Final

from octet_slave import DL, RS, SC, frame, sd1, sd2

_S: Final = 1_000_000_000
_MS: Final = 1_000_000
#: bits of one octet, of the silence before a request, and between a request and its answer
CHAR_BITS: Final = 11
SYN_BITS: Final = 33
ANSWER_BITS: Final = 11
FCB: Final = 0x20
FCV: Final = 0x10
IDENT: Final = b"\x06\x96"
CONFIG: Final = b"\x13\x21"  # four octets of inputs, two of outputs

WAIT_PRM: Final = "wait_prm"
WAIT_CFG: Final = "wait_cfg"
DATA_EXCHANGE: Final = "data_exchange"


def is_live(outputs: bytes) -> bool:
    """Whether these are outputs of a running plant: the first octet has its high bit, as no safe value has."""
    return outputs[:1] >= b"\x80"


def telegram(octets: bytes) -> bytes | None:
    """``octets`` when they are one whole telegram with right check sums, else None."""
    match octets[:1]:
        case b"\x10":
            good = len(octets) == 6 and sum(octets[1:4]) & 0xFF == octets[4] and octets[5] == 0x16
        case b"\x68":
            size = len(octets) - 6
            good = (
                size >= 3
                and octets[1] == octets[2] == size
                and octets[3] == 0x68
                and sum(octets[4:-2]) & 0xFF == octets[-2]
                and octets[-1] == 0x16
            )
        case b"\xdc":
            good = len(octets) == 3
        case _:
            good = False
    return octets if good else None


@dataclass(eq=False)
class WireSlave:
    """A DP slave. It takes its outputs back when its watchdog ends, and by Clear."""

    address: int
    state: str = WAIT_PRM
    master: int = 255
    outputs: bytes = bytes(2)
    watchdog_ns: int = 0
    heard_at: int = 0
    #: ends of watchdogs
    trips: list[int] = field(default_factory=list)
    #: outputs of Data_Exchange: time, octets, and whether the slave took them
    given: list[tuple[int, bytes, bool]] = field(default_factory=list)
    #: Global_Control: time, control octet
    controls: list[tuple[int, int]] = field(default_factory=list)
    #: inputs of all answers
    said: list[bytes] = field(default_factory=list)
    repeated: int = 0
    #: new requests that it had to take for repetitions by their frame count bit
    skipped: int = 0
    _fcb: int = -1
    _last_request: bytes = b""
    _last_answer: bytes | None = None

    def elapse(self, now: int) -> None:
        """The watchdog acts if nothing was heard for its time."""
        if self.state == DATA_EXCHANGE and self.watchdog_ns and now - self.heard_at > self.watchdog_ns:
            self.trips.append(self.heard_at + self.watchdog_ns)
            self.state, self.master, self.outputs = WAIT_PRM, 255, bytes(2)

    def answer(self, request: bytes, now: int) -> bytes | None:
        """The answer to a telegram to this address whose last bit was on the wire at ``now``."""
        self.elapse(now)
        place = 1 if request[0] == 0x10 else 4
        sa, fc = request[place + 1] & 0x7F, request[place + 2]
        if not fc & 0x40:
            return None
        if sa == self.master:
            self.heard_at = now
        if fc & FCV and fc & FCB == self._fcb:
            self.repeated += 1
            self.skipped += request != self._last_request
            return self._last_answer
        answer = self._serve(request, sa, fc & 0x0F, now)
        if fc & (FCV | FCB):
            self._fcb, self._last_request, self._last_answer = fc & FCB, request, answer
        return answer

    def control(self, request: bytes, now: int) -> None:
        """A telegram to all."""
        self.elapse(now)
        if request[7] != 58:
            return
        self.controls.append((now, request[9]))
        if self.state == DATA_EXCHANGE and request[5] & 0x7F == self.master:
            self.heard_at = now
            if request[9] & 0x02:
                self.outputs = bytes(2)

    def last_octets(self) -> str:
        """The last outputs on the wire for this slave, and how often Clear came after the last live ones (up to 2)."""
        at, data = 0, "nothing"
        since = 0
        if self.given:
            at, octets, _ = self.given[-1]
            data = "live" if is_live(octets) else "safe values" if any(octets) else "zeros"
            since = max((at for at, octets, _ in self.given if is_live(octets)), default=0)
        clears = 0
        for at, control in self.controls:
            if at > since:
                clears = clears + 1 if control & 0x02 else 0
        return f"{data}, Clear x {min(clears, 2)}"

    def _serve(self, request: bytes, sa: int, function: int, now: int) -> bytes | None:
        if request[0] == 0x10 and function == 0x09:
            return sd1(sa, self.address, 0x00)
        refusal = sd1(sa, self.address, RS)
        if request[0] == 0x10:
            return refusal
        if not request[4] & 0x80:
            return self._exchange(request[7:-2], sa, now)
        data = request[9:-2]
        match request[7]:
            case 60:
                ready = self.state == DATA_EXCHANGE
                status = b"\x00\x0c\x00" if ready else b"\x02\x05\x00" if self.state == WAIT_PRM else b"\x02\x04\x00"
                return sd2(sa, self.address, DL, request[8], 60, status + bytes((self.master,)) + IDENT)
            case 61:
                if data[4:6] != IDENT or not data[0] & 0x80:
                    return refusal
                self.watchdog_ns = data[1] * data[2] * 10 * _MS if data[0] & 0x08 else 0
                self.state, self.master, self.heard_at = WAIT_CFG, sa, now
                return SC
            case 62 if self.state == WAIT_CFG and data == CONFIG:
                self.state = DATA_EXCHANGE
                return SC
        return refusal

    def _exchange(self, outputs: bytes, sa: int, now: int) -> bytes:
        takes = self.state == DATA_EXCHANGE and len(outputs) == 2 and sa == self.master
        self.given.append((now, outputs, takes))
        if not takes:
            return sd1(sa, self.address, RS)
        self.outputs = outputs
        inputs = bytes((self.address, len(self.said) & 0xFF)) + outputs
        self.said.append(inputs)
        return frame(bytes((sa, self.address, DL)) + inputs)


class Wire:
    """``slaves`` on a wire at ``baud`` bit/s."""

    def __init__(self, baud: int, slaves: Iterable[WireSlave]) -> None:
        self.baud = baud
        self.slaves = {slave.address: slave for slave in slaves}
        #: end of the last octet, whoever sent it
        self.busy_until = 0
        #: telegrams of the master that began before 33 bits of silence were over, and in an answer
        self.without_pause = 0
        self.collisions = 0
        self.tokens: list[int] = []
        self.damaged = 0

    def ns(self, bits: int) -> int:
        """``bits`` bit times."""
        return bits * _S // self.baud

    def transmit(self, octets: bytes, at: int) -> tuple[bytes, int]:
        """The master's ``octets`` from ``at`` on: the answer, empty for none, and when that begins."""
        quiet = at - self.busy_until
        damaged = telegram(octets) is None
        if quiet < 0:
            self.collisions += 1
            damaged = True
        elif quiet < self.ns(SYN_BITS):
            self.without_pause += 1
            damaged = True
        end = at + self.ns(CHAR_BITS * len(octets))
        self.busy_until = max(self.busy_until, end)
        answer = None
        if damaged:
            self.damaged += 1
        elif octets[0] == 0xDC:
            self.tokens.append(end)
        else:
            da = octets[1 if octets[0] == 0x10 else 4] & 0x7F
            if da == 127:
                for slave in self.slaves.values():
                    slave.control(octets, end)
            elif da in self.slaves:
                answer = self.slaves[da].answer(octets, end)
        begin = end + self.ns(ANSWER_BITS)
        if answer:
            self.busy_until = begin + self.ns(CHAR_BITS * len(answer))
        return answer or b"", begin
