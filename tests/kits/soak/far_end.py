"""Slaves of octets on a pty of their own, in a process of their own, which count and time all that arrives.

Nothing of the project is imported; the slaves are those of ``support_responder``.

    python -m soak.far_end CYCLE_MS WINDOW_S SPEC...

It prints one JSON line with its port. Each line on standard input is answered by a JSON line with the account so far;
``begin`` also begins the grid of the fixed cycle anew with the next round. The end of the input ends it.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
import tty
from dataclasses import dataclass, field
from time import monotonic_ns

from support_responder import Responder, cut

_NS_PER_MS = 1_000_000
_LOOK_S = 0.01


@dataclass
class Arrivals:
    """Rounds on their grid as they arrive. ``windows``: of each window of time the rounds, the places on the grid
    without one, and the least and the greatest delay against the first round of all, in ns (below 0: earlier)."""

    cycle_ns: int
    window_ns: int
    windows: list[list[int]] = field(default_factory=list)
    first_ns: int = -1
    place: int = -1
    until_ns: int = 0

    def add(self, at_ns: int) -> None:
        if self.first_ns < 0:
            self.first_ns = at_ns
        if at_ns >= self.until_ns:
            self.until_ns = at_ns + self.window_ns
            self.windows.append([0, 0, 1 << 62, -(1 << 62)])
        # the first round may have been late itself: others may be earlier by up to a quarter of a cycle
        place = (at_ns - self.first_ns + self.cycle_ns // 4) // self.cycle_ns
        late_ns = at_ns - self.first_ns - place * self.cycle_ns
        window = self.windows[-1]
        window[0] += 1
        window[1] += max(0, place - self.place - 1)
        window[2] = min(window[2], late_ns)
        window[3] = max(window[3], late_ns)
        self.place = place


class FarEnd:
    """The slaves of ``specs`` at the far end of a pty; ``name`` is the end that a program opens."""

    def __init__(self, cycle_ns: int, window_ns: int, specs: list[str]) -> None:
        self.fd, near = os.openpty()
        tty.setraw(near)
        self.name = os.ttyname(near)
        self.slaves = Responder(self.name, specs)  # keeps the near end open: nothing hangs up between two programs
        os.close(near)
        self.arrivals = Arrivals(cycle_ns, window_ns)
        self.begun = False
        #: the longest time in which this process did not run although it could
        self.stood_still_ns = 0
        self.octets = self.tokens = self.requests = self.answers = self.junk = self.late = self.polls = 0
        self._buffer = bytearray()
        self._last = 127

    def serve(self) -> None:
        """Serve until the pty is closed."""
        while True:
            try:
                chunk = os.read(self.fd, 4096)
            except OSError:
                return
            now = monotonic_ns()
            out = self.feed(chunk, now)
            if out:
                self.answers += 1
                os.write(self.fd, out)

    def watch_itself(self) -> None:
        """Note how long this process stands still; a slave is lost where that is longer than all attempts take."""
        while True:
            before = monotonic_ns()
            time.sleep(_LOOK_S)
            self.stood_still_ns = max(self.stood_still_ns, monotonic_ns() - before - int(_LOOK_S * 1e9))

    def feed(self, chunk: bytes, now: int) -> bytes:
        """The answer to the last request in ``chunk``; an earlier one in it is too old and is counted in ``late``."""
        buffer = self._buffer
        buffer += chunk
        self.octets += len(chunk)
        out = b""
        while buffer:
            before = len(buffer)
            body = cut(buffer)
            taken = before - len(buffer)
            if body is None:
                self.junk += taken
                break
            if body:
                self.late += bool(out)
                out = self.request(body, now)
                size = 6 if len(body) == 3 else len(body) + 6
            else:  # a master sends no short acknowledgement
                self.tokens += 1
                size = 3
            self.junk += taken - size
        return out

    def request(self, body: bytes, now: int) -> bytes:
        """One request from DA on, which was read at ``now``."""
        self.requests += 1
        da, sa, fc = body[:3]
        slave = self.slaves.slaves.get(da)
        if slave is None or sa & 0x80 or fc == 0x49:
            self.polls += fc == 0x49
            return self.slaves.request(body)
        repeats = slave.repeats
        out = self.slaves.request(body)
        if slave.repeats == repeats:
            if da <= self._last and self.begun:
                self.arrivals.add(now)
            self._last = da
        return out

    def account(self) -> dict[str, object]:
        """All counters so far."""
        slaves = self.slaves.slaves.items()
        return {
            "octets": self.octets,
            "telegrams": self.tokens + self.requests,
            "tokens": self.tokens,
            "polls": self.polls,
            "answers": self.answers,
            "junk": self.junk,
            "late": self.late,
            "exchanges": {str(address): slave.exchanges for address, slave in slaves},
            "repeats": sum(slave.repeats for _, slave in slaves),
            "expired": sum(slave.expired for _, slave in slaves),
            "control": [slave.control.hex() for _, slave in slaves],
            "outputs": [slave.outputs.hex() for _, slave in slaves],
            "places": self.arrivals.place + 1,
            "stood_still_ms": self.stood_still_ns // _NS_PER_MS,
            "windows": self.arrivals.windows,
        }


def main() -> int:
    cycle_ms, window_s, *specs = sys.argv[1:]
    far = FarEnd(int(float(cycle_ms) * _NS_PER_MS), int(float(window_s) * 1000 * _NS_PER_MS), specs)
    for work in (far.serve, far.watch_itself):
        threading.Thread(target=work, daemon=True).start()
    print(json.dumps({"port": far.name}), flush=True)
    for line in sys.stdin:
        if line.strip() == "begin":
            far.arrivals = Arrivals(far.arrivals.cycle_ns, far.arrivals.window_ns)
            far.begun = True
        print(json.dumps(far.account()), flush=True)
    os._exit(0)  # the other thread reads


if __name__ == "__main__":
    sys.exit(main())
