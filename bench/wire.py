"""The other end of the benchmarks: slaves of octets on a pty of its own, free or on a wire that takes its time.

Nothing of the project is imported; the slaves are those of tests/kits/support_responder.py. On a paced wire every
telegram, requests too, lasts 11 bits an octet; a request begins when it is read here, no sooner than the idle time of
the rules after what was on the wire before (what came sooner is counted in ``held``); answers begin min T_SDR later and
are handed over in slices. With ``--collide`` a request that comes before the end of an answer gets none itself, and the
rest of that answer is inverted. Behind an adapter requests wait for a USB frame, answers for a full packet or the
latency timer and for a frame.

It prints one JSON line with the port. Then lines on standard input: ``begin`` forgets what was recorded, ``end FILE``
writes it as JSON, ``count`` does nothing; each is answered by the number of exchanges since ``begin``. The end of the
input ends it.
"""

from __future__ import annotations

import argparse
import contextlib
import ctypes
import json
import os
import select
import sys
import threading
import tty
from collections.abc import Iterator
from pathlib import Path
from time import monotonic_ns, process_time_ns
from typing import Final

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tests" / "kits"))

from support_responder import Responder, cut

_MS: Final = 1_000_000
_US: Final = 1_000
#: sooner than this a wait is spun
_SPIN: Final = 150 * _US
#: so long it looks for octets without sleeping: what comes later comes from a master that has nothing urgent
_LOOK: Final = 400 * _US
_FOREVER: Final = 1 << 62
#: who does not run for so long while there is something to do is held up; so many such times are told
_HELD_UP: Final = 10 * _MS
_LONGEST: Final = 5

#: one telegram of the master: read here, begins on the wire, ends there, the answer's end there (or 0), when the
#: answer's last octet was due at the master and when it was written (or 0), first octet, DA (or -1), octets, octets of
#: the answer
Record = list[int]
_ANSWER_END: Final = 3
_WRITTEN: Final = 5


class Wire:
    """A wire of ``baud`` with the idle times ``t_id1``, ``t_id2``, ``t_sl`` (bit times) that the rules ask for."""

    def __init__(self, slaves: list[str], options: argparse.Namespace) -> None:
        master, far = os.openpty()
        tty.setraw(far)
        self.name = os.ttyname(far)
        self._fd = master
        os.set_blocking(master, False)
        self._slaves = Responder(self.name, slaves)  # keeps the far end open: between two programs nothing hangs up
        os.close(far)
        self._buffer = bytearray()
        self._options = options
        self._bit: float = 1_000_000_000 / options.baud
        self._slice = max(1, options.slice_bits // 11)
        self._free_at = 0  # from when on the next telegram may begin by the rules
        self._packet_at = 0  # when the adapter handed over its last packet
        #: what is to be written, and when
        self.pieces: list[tuple[int, bytes]] = []
        self.records: list[Record] = []
        self._last: Record = []
        self.held = 0
        self.count = 0
        self.cpu = 0
        #: when this process had something to do and did not run, and for how long, in ns: the longest times
        self._held_up: list[tuple[int, int]] = []
        self._runs_at = _FOREVER  # it was to go on then
        #: why it serves no more
        self.over = ""

    def bits(self, count: float) -> int:
        """``count`` bit times in ns."""
        return round(count * self._bit)

    def serve(self) -> None:
        """Serve until the process is ended, or the line."""
        try:
            (self.run if self._options.paced else self.run_free)()
            self.over = "its line was closed"
        except Exception as error:
            self.over = f"{type(error).__name__}: {error}"
            raise

    def run(self) -> None:
        looking_until = 0
        while True:
            due = self.pieces[0][0] if self.pieces else _FOREVER
            now = monotonic_ns()
            self._held_up = self.held_up(now)
            self._runs_at = now
            if due <= now:
                os.write(self._fd, self.pieces.pop(0)[1])
                now = monotonic_ns()
                looking_until = now + _LOOK
                if not self.pieces:
                    self._last[_WRITTEN] = now
                continue
            if due - now > _SPIN and (self.pieces or now > looking_until):
                wait = 0.05 if due == _FOREVER else (due - now - _SPIN // 2) / 1e9
                self._runs_at = now + round(wait * 1e9)
                if not select.select((self._fd,), (), (), wait)[0]:
                    continue
            try:
                chunk = os.read(self._fd, 4096)
            except BlockingIOError:
                continue
            except OSError:
                return
            if chunk:
                self.take(chunk, monotonic_ns())

    def run_free(self) -> None:
        """As :meth:`run`, without a wire: an answer is written at once. Only exchanges are counted."""
        fd, feed = self._fd, self._slaves.feed
        os.set_blocking(fd, True)
        chunk = os.read(fd, 4096)
        while True:
            try:
                out = feed(chunk)
                if out:
                    os.write(fd, out)
                chunk = os.read(fd, 4096)
            except OSError:
                return

    def take(self, chunk: bytes, now: int) -> None:
        """Octets of the master, read at ``now``: what follows from them goes to ``records`` and ``pieces``."""
        buffer = self._buffer
        buffer += chunk
        while buffer:
            first, before = buffer[0], bytes(buffer)
            body = cut(buffer)
            if body is None:
                return
            octets = len(before) - len(buffer)
            self._telegram(first, body, before[:octets], now)

    def _telegram(self, first: int, body: bytes, octets: bytes, now: int) -> None:
        options = self._options
        if options.collide and self._last and now < self._last[_ANSWER_END]:
            self.pieces = [(due, bytes(octet ^ 0xFF for octet in piece)) for due, piece in self.pieces]
            body = b""
        ready = self._framed(now)
        begin = max(ready, self._free_at)
        if begin - ready > self.bits(1):
            self.held += 1
        end = begin + self.bits(11 * len(octets))
        answer = self._slaves.request(body) if body else b""
        if answer:
            starts = end + self.bits(options.min_tsdr)
            over = starts + self.bits(11 * len(answer))
            self.pieces = [*self.pieces, *(self._handed_over if options.frame_us else self._sliced)(answer, starts)]
            self._free_at = over + self.bits(options.t_id1)
        else:
            over = 0
            broadcast = bool(body) and body[0] & 0x7F == 127
            silent = bool(body) and not broadcast and body[2] & 0x40
            idle = options.t_id2 if broadcast else options.t_sl if silent else options.t_id1
            self._free_at = end + self.bits(idle)
        handed = self.pieces[-1][0] if answer else 0
        to = body[0] & 0x7F if body else -1
        self._last = [now, begin, end, over, handed, 0, first, to, len(octets), len(answer)]
        self.records.append(self._last)

    def _sliced(self, answer: bytes, starts: int) -> Iterator[tuple[int, bytes]]:
        step = self._slice
        for n in range(0, len(answer), step):
            piece = answer[n : n + step]
            yield starts + self.bits(11 * (n + len(piece))), piece

    # --- an adapter's habits ---
    def _framed(self, at: int) -> int:
        """The first USB frame not before ``at``."""
        frame = self._options.frame_us * _US
        return -(-at // frame) * frame if frame else at

    def _handed_over(self, answer: bytes, starts: int) -> Iterator[tuple[int, bytes]]:
        """In packets: full, or when the latency timer has run out (it begins anew with every packet)."""
        size, latency = self._options.packet, self._options.latency_ms * _MS
        ends = [starts + self.bits(11 * (n + 1)) for n in range(len(answer))]
        taken = 0
        while taken < len(answer):
            expiry = self._packet_at + latency
            if expiry < ends[taken]:
                expiry += -(-(ends[taken] - expiry) // latency) * latency
            at = self._framed(expiry)
            if len(answer) - taken >= size:
                at = min(at, self._framed(ends[taken + size - 1]))
            upto = max(taken + 1, min(taken + size, sum(end <= at for end in ends)))
            yield max(at, ends[upto - 1]), answer[taken:upto]
            self._packet_at, taken = at, upto

    def held_up(self, now: int) -> list[tuple[int, int]]:
        """When and for how long, with what may still last."""
        late = now - self._runs_at
        if late <= _HELD_UP:
            return self._held_up
        return sorted((*self._held_up, (self._runs_at, late)), key=lambda pause: -pause[1])[:_LONGEST]

    # --- orders ---
    def obey(self) -> None:
        """Orders from standard input, until it ends."""
        for line in sys.stdin:
            order, _, path = line.strip().partition(" ")
            if order == "begin":
                self.records, self.held = [], 0
                self.count, self.cpu = self.exchanges(), process_time_ns()
            elif order == "end":
                records, held = self.records, self.held
                data = {
                    "records": records[:-1],  # the last one may be under way
                    "held": held,
                    "exchanges": self.exchanges() - self.count,
                    "cpu": process_time_ns() - self.cpu,
                    "held_up": self.held_up(monotonic_ns()),  # it may not have run again yet
                    "over": self.over,
                }
                Path(path).write_text(json.dumps(data), encoding="utf-8")
            print(self.exchanges() - self.count, flush=True)
        os._exit(0)  # the other thread is in the middle of something

    def exchanges(self) -> int:
        """Data_Exchange services of all slaves so far."""
        return sum(slave.exchanges for slave in self._slaves.slaves.values())


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("slaves", nargs="+", help="as of tests/kits/support_responder.py")
    parser.add_argument("--baud", type=int, required=True)
    parser.add_argument("--paced", action="store_true", help="telegrams take their time")
    parser.add_argument("--collide", action="store_true", help="a request before the end of an answer spoils both")
    parser.add_argument("--min-tsdr", type=int, default=11, help="bit times, like the next three")
    parser.add_argument("--t-id1", type=int, default=37)
    parser.add_argument("--t-id2", type=int, default=60)
    parser.add_argument("--t-sl", type=int, default=100)
    parser.add_argument("--slice-bits", type=int, default=50, help="answers come in slices of so many bit times")
    parser.add_argument("--frame-us", type=int, default=0, help="a USB adapter's frame, 0: no adapter")
    parser.add_argument("--latency-ms", type=int, default=16, help="its latency timer")
    parser.add_argument("--packet", type=int, default=62, help="octets in its full packet")
    options = parser.parse_args()
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(29, 1, 0, 0, 0)  # PR_SET_TIMERSLACK: sleeps end in time
    with contextlib.suppress(OSError):
        # Where it is permitted: other programs shall not change the wire's time. Not for its session as a whole
        # (autogroup): that took the time of the kernel's workers, which carry a pty's octets (5 ms a rotation).
        os.nice(-20)
    wire = Wire(options.slaves, options)
    threading.Thread(target=wire.serve, daemon=True).start()
    print(json.dumps({"port": wire.name}), flush=True)
    wire.obey()
    return 0


if __name__ == "__main__":
    sys.exit(main())
