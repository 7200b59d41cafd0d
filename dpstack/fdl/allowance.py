"""Limit of the bus time for polls of addresses where no station may be."""

from __future__ import annotations


class Allowance:
    """Limit of the bus time that silent polls of unknown addresses may take: an account of nanoseconds.

    The account earns 1/``divisor`` of the time that passes, up to sixteen polls of ``cost_ns``, and starts full.
    ``divisor`` 0: no limit.
    """

    def __init__(self, divisor: int, cost_ns: int, now: int) -> None:
        self.divisor = divisor
        self._cost_ns = cost_ns
        self._cap_ns = self._credit_ns = 16 * cost_ns
        self._at = now

    def allows(self, now: int) -> bool:
        """Whether the account has enough for one more silent poll."""
        if not self.divisor:
            return True
        # only whole ns: the remainder of the division counts in the next call
        earned = (now - self._at) // self.divisor
        if earned > 0:
            self._at += earned * self.divisor
            self._credit_ns = min(self._cap_ns, self._credit_ns + earned)
        return self._credit_ns >= self._cost_ns

    def charge(self, ns: int) -> None:
        """Take the ``ns`` of a silent poll from the account. The debt is limited, so that GAP polls soon go on."""
        if self.divisor:
            self._credit_ns = max(-self._cap_ns, self._credit_ns - ns)
