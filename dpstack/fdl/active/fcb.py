"""Requester side of the frame count bit: FCB and FCV of the next request, per responder.

docs/reference/protocol.md#frame-count-bit: the first request to a station, or the first after it was given up, goes out
with FCV = 0 and FCB = 1 and is not repeated. Once answered the station is operational: FCV = 1, and FCB toggles with
each new request but not with a repetition. Some slaves know only requests with FCV = 1 (0x5D, 0x7D): a probe with FCV =
1 after three silent requests finds them.
"""

from __future__ import annotations

from typing import Final

from dpstack.fdl.telegram import FC_FCB, FC_FCV

#: FC bits of a first request.
FIRST: Final = FC_FCB
#: Silent first requests before one probe with FCV = 1.
ROUNDS_BEFORE_PROBE: Final = 3


class FrameCount:
    """FCB and FCV for every responder address 0..127. FC bits are already in place (0x20 FCB, 0x10 FCV)."""

    def __init__(self) -> None:
        #: FC bits of the next new request and of its repetitions, by address
        self.bits = [FIRST] * 128
        self._misses = [0] * 128
        self._probes = [0] * 128
        #: stations that answered the last request: repetitions make sense
        self.operational = [False] * 128
        #: stations that answered only a probe with FCV = 1
        self.fcv_only: set[int] = set()

    def answered(self, address: int) -> bool:
        """``address`` answered. True when this is its first answer, and it came only to a probe with FCV = 1."""
        if self.operational[address]:
            self.bits[address] ^= FC_FCB
            return False
        bits = self.bits[address]
        self.bits[address] = (bits ^ FC_FCB) | FC_FCV
        self.operational[address] = True
        if bits & FC_FCV and address not in self.fcv_only:
            self.fcv_only.add(address)
            return True
        if not bits & FC_FCV:
            self.fcv_only.discard(address)
        return False

    def given_up(self, address: int) -> None:
        """A request to ``address`` ended without an answer: the station is not (or no longer) operational."""
        if self.operational[address]:
            self._begin_anew(address)
            return
        self._misses[address] += 1
        self._first_or_probe(address)

    def restart(self, address: int) -> None:
        """Begin anew with ``address``. The count of silent requests continues."""
        if self.operational[address]:
            self._begin_anew(address)

    def _begin_anew(self, address: int) -> None:
        self.operational[address] = False
        # a station that understands only FCV = 1 gets the probe first, instead of three requests in vain
        self._misses[address] = ROUNDS_BEFORE_PROBE if address in self.fcv_only else 0
        self._first_or_probe(address)

    def _first_or_probe(self, address: int) -> None:
        if self._misses[address] < ROUNDS_BEFORE_PROBE:
            self.bits[address] = FIRST
            return
        self._misses[address] = -1  # the probe makes it 0: three more requests follow
        # A responder that did hear a first request keeps FCB = 1, so the first probe uses FCB = 0 (a new request for
        # it); the next probe the other one, for a responder whose kept FCB is unknown.
        self.bits[address] = FC_FCV | (FC_FCB if self._probes[address] & 1 else 0)
        self._probes[address] += 1
