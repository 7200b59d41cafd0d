"""The share of the bus time that polls of addresses may take where nobody may be."""

from __future__ import annotations


class Allowance:
    """The share of the bus time that silent polls of unknown addresses may take: an account of nanoseconds.

    It earns 1/``share`` of the time that passes, up to sixteen polls of ``cost_ns``, and starts full. ``share`` 0: no
    limit.
    """

    __slots__ = ("_at", "_cap_ns", "_cost_ns", "_credit_ns", "share")

    def __init__(self, share: int, cost_ns: int, now: int) -> None:
        self.share = share
        self._cost_ns = cost_ns
        self._cap_ns = self._credit_ns = 16 * cost_ns
        self._at = now

    def allows(self, now: int) -> bool:
        """Whether one more silent poll fits in."""
        if not self.share:
            return True
        # whole units only: the rest of the division is earned later, not lost
        earned = (now - self._at) // self.share
        if earned > 0:
            self._at += earned * self.share
            self._credit_ns = min(self._cap_ns, self._credit_ns + earned)
        return self._credit_ns >= self._cost_ns

    def charge(self, ns: int) -> None:
        """A poll of ``ns`` was silent. Debts are bounded too: whoever overdraws it does not end the GAP for long."""
        if self.share:
            self._credit_ns = max(-self._cap_ns, self._credit_ns - ns)
