"""Which rate a slave's receiver listens at, and how it came there.

It listens at one rate after the other (BAUD_SEARCH); once the rate is found it watches that telegrams keep coming
(BAUD_CONTROL); parameterised with the watchdog on, that watches the master instead (DP_MODE). States and transitions
are those of the VPC3+ (docs/protocol.md#baud-search): a watchdog that expires leads back to BAUD_CONTROL, silence there
to BAUD_SEARCH; with the watchdog off losing the rate restarts the search, but the slave stays in Data_Exchange.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import Enum
from typing import Final

from dpstack.fdl.baud_search import AutoBaud, BaudFound
from dpstack.fdl.telegram import Telegram
from dpstack.params import BusParams
from dpstack.units import BAUD_RATES, NEVER, NOW

#: BAUD_CONTROL gives up after T_TO of a station that is no master (docs/protocol.md#t_to): 6 T_SL + 2 x 130 T_SL. A
#: master that is alive is never silent for so long; the chips have a register for it.
_CONTROL_SLOTS: Final = 6 + 2 * 130


class BaudState(Enum):
    """The states of the VPC3+'s watchdog."""

    SEARCH = "baud_search"
    CONTROL = "baud_control"
    DP_MODE = "dp_mode"


class BaudWatch:
    """The rule of one receiver, whatever is behind it.

    ``watched`` tells whether a watchdog runs there, ``found`` takes the parameters (``params_at``) of a rate that was
    found, ``reached`` is told of every other state. ``rates`` in bit/s. ``slack_ns`` is how late the port may deliver,
    ``settle_ns`` see :class:`AutoBaud`.
    """

    __slots__ = (
        "_control_ns",
        "_found",
        "_heard_at",
        "_params_at",
        "_rate",
        "_rates",
        "_reached",
        "_search",
        "_settle_ns",
        "_slack_ns",
        "_watched",
        "state",
    )

    def __init__(
        self,
        watched: Callable[[], bool],
        found: Callable[[BusParams, int], None],
        reached: Callable[[BaudState, int], None],
        *,
        rates: Sequence[int] = BAUD_RATES,
        params_at: Callable[[int], BusParams] = BusParams.preset,
        slack_ns: int = 0,
        settle_ns: int = 0,
    ) -> None:
        self.state = BaudState.SEARCH
        self._watched = watched
        self._found = found
        self._reached = reached
        self._rates = rates
        self._params_at = params_at
        self._slack_ns = slack_ns
        self._settle_ns = settle_ns
        self._search: AutoBaud | None = None  # begins with the first call that tells the time
        self._rate = max(rates)
        self._heard_at = 0
        self._control_ns = 0

    @property
    def searching(self) -> bool:
        """The rate is not known (any more)."""
        return self.state is BaudState.SEARCH

    @property
    def baud(self) -> int:
        """The rate to listen at now, in bit/s."""
        return self._rate if self._search is None else self._search.baud

    def search(self, now: int) -> AutoBaud:
        if self._search is None:
            self._search = AutoBaud(now, rates=self._rates, slack_ns=self._slack_ns, settle_ns=self._settle_ns)
        return self._search

    # --- what is heard ---
    def octets(self, chunk: bytes, now: int) -> None:
        """While searching: octets, at whatever rate it listens."""
        self.search(now).receive(chunk, now)
        self._judge(now)

    def telegram(self, telegram: Telegram, now: int) -> None:
        """While searching: a whole telegram."""
        self.search(now).telegram(telegram, now)
        self._judge(now)

    def heard(self, now: int) -> None:
        """A telegram came at the rate found."""
        self._heard_at = now

    # --- time ---
    def wake(self, now: int) -> None:
        """Judge the search, or the silence."""
        if self.searching:
            self.search(now).wake(now)
            self._judge(now)
            return
        watched = self._watched()
        if watched is not (self.state is BaudState.DP_MODE):
            # the time without a watchdog over it begins, or ends, here
            self._heard_at = now
            self._reach(BaudState.DP_MODE if watched else BaudState.CONTROL, now)
        elif not watched and now >= self._heard_at + self._control_ns:
            self._rate = max(self._rates)
            self._reach(BaudState.SEARCH, now)

    def wake_at(self) -> int:
        """The next step of the search, the end of patience with silence; NOW when a watchdog came or went."""
        if self.searching:
            return NOW if self._search is None else self._search.wake_at()
        watched = self._watched()
        if watched is not (self.state is BaudState.DP_MODE):
            return NOW
        return NEVER if watched else self._heard_at + self._control_ns

    # --- the port ---
    def begin_anew(self) -> None:
        """The line was away: what was heard of it while searching is nothing to go by."""
        self._search = None

    def refused(self, now: int) -> None:
        """The port cannot do :attr:`baud`. Raises ConfigError when it can do none."""
        self.search(now).refused(now)

    # --- inside ---
    def _judge(self, now: int) -> None:
        result = self.search(now).result
        if isinstance(result, BaudFound):
            params = self._params_at(result.baud)
            self._rate = result.baud
            self._search = None
            self._control_ns = params.ns(_CONTROL_SLOTS * params.t_sl) + self._slack_ns
            self._heard_at = now
            self._found(params, now)
            self._reach(BaudState.DP_MODE if self._watched() else BaudState.CONTROL, now)

    def _reach(self, state: BaudState, now: int) -> None:
        self.state = state
        self._reached(state, now)
