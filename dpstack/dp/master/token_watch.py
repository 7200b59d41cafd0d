"""How long this station has had no token: after too long nobody can be in data exchange any more."""

from __future__ import annotations

from typing import Final

from dpstack.params import BusParams
from dpstack.units import NEVER, NS_PER_S

#: without a token for T_TR and so long nobody can be in data exchange any more; an ordered end waits only so long
_SILENCE: Final = NS_PER_S


class TokenAge:
    """``watch_at``: when :meth:`too_old` is to be asked, in ns, or NEVER. It is moved on only there."""

    def __init__(self, params: BusParams) -> None:
        #: first bit of the last request: what is sent after a token is its sign of life
        self.sent_at = 0
        self.watch_at = NEVER
        self._at = NEVER
        self._since = 0
        self._held_ns = 0  # nobody ran this station for so long since the last token
        # at 9.6 kbit/s one rotation may rightly take T_TR = 5 s
        self._limit = _SILENCE + params.ns(params.t_tr)

    @property
    def known(self) -> bool:
        """There was a token, and it is not known to be lost."""
        return self._at != NEVER

    def received(self, now: int) -> None:
        """A token hold begins."""
        self._at = now
        self._held_ns = 0
        if self.watch_at == NEVER:
            self.watch_at = self._quiet_at()

    def ending(self, now: int) -> None:
        """The end was ordered: it is not waited for as long as otherwise."""
        self._limit = _SILENCE
        self._since = now
        self.watch_at = self._quiet_at()

    def held_up(self, for_ns: int) -> None:
        """Nobody ran this station for so long: it could take no token in that time, which does not count therefore."""
        self._held_ns += for_ns

    def lost(self) -> None:
        """No token, or none is needed any more."""
        self._at = self.watch_at = NEVER

    def too_old(self, now: int) -> bool:
        """Whether the present silence is too long."""
        quiet_at = self._quiet_at()
        if now < quiet_at:
            self.watch_at = quiet_at
            return False
        return True

    def _quiet_at(self) -> int:
        if self._at == NEVER:
            return NEVER
        return max(self._at, self.sent_at, self._since) + self._held_ns + self._limit
