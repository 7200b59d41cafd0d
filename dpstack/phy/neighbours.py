"""The T_SL and T_TO that other masters need beside a port that delivers late.

The other masters do not know the delay ``unknown_ns`` of this port (there and back). It has two effects. First, the
first octet of the station after a token, or the answer of a simulated slave, is late by this delay. It has to begin
within T_SL, else the other master passes the token on or repeats the request. Second, while the station holds the token
it waits longer for stations that do not answer: another master with address n claims the token after a silence of
T_TO = (6 + 2 n) T_SL (docs/reference/protocol.md#t_to). All masters of a bus have the same T_SL, so one calculation is
enough.
"""

from __future__ import annotations

from typing import Final

from msgspec import Struct

from dpstack.params import MAX_T_SL, BusParams
from dpstack.phy.patience import ADAPTER, Patience
from dpstack.units import BAUD_RATES, NS_PER_S, baud_text, ms_text

#: minimum difference in bit times between T_SL and the longest time to the first bit (as max T_SDR + 15 <= T_SL)
_MARGIN: Final = 15


def t_sl_of_answers(params: BusParams, patience: Patience) -> int:
    """T_SL in bit times that a master needs if a station on such a port answers it or receives its token.

    0 on ports without a wire (``sending_ns`` 0): the other masters are programs on such ports and have their own slack.
    """
    if not patience.sending_ns:
        return 0
    return _bits_up(patience.unknown_ns, params.baud) + max(params.t_id1, params.max_tsdr) + _MARGIN


class Neighbours(Struct, frozen=True):
    """Needs of the other masters beside a master with ``params`` and ``patience``; ``lowest``: their lowest address."""

    params: BusParams
    patience: Patience
    lowest: int = 0

    @property
    def t_sl(self) -> int:
        """T_SL in bit times for all masters of the bus, 0 if any T_SL will do."""
        answers = t_sl_of_answers(self.params, self.patience)
        if not answers:
            return 0
        slack = _bits_up(self.patience.known_ns + self.patience.unknown_ns, self.params.baud)
        # T_SL + slack < (6 + 2 n) T_SL
        return max(answers, slack // (5 + 2 * self.lowest) + 1)

    @property
    def silence_ns(self) -> int:
        """The longest silence while this station holds the token and a known station does not answer."""
        return self.params.ns(self.params.t_sl) + self.patience.known_ns + self.patience.unknown_ns

    @property
    def t_to_ns(self) -> int:
        """The silence after which the lowest of them claims the token, with the T_SL of ``params``."""
        return self.params.ns(self.params.t_to_of(self.lowest))

    def advice(self) -> str:
        """Advice for the user with the figures; empty when T_SL of ``params`` is enough."""
        need, params = self.t_sl, self.params
        if need <= params.t_sl:
            return ""
        how = "assumed until it is measured" if self.patience == ADAPTER else "measured, or host_slack_ms"
        why = (
            f"over this port the first octet after a token comes up to {ms_text(self.patience.unknown_ns)} late "
            f"({how}), where they wait {ms_text(params.ns(params.t_sl))}"
        )
        if self.silence_ns > self.t_to_ns:
            why += (
                f", and while it waits {ms_text(self.silence_ns)} for a silent station "
                f"master {self.lowest} claims the token after {ms_text(self.t_to_ns)}"
            )
        at = baud_text(params.baud)
        if need > MAX_T_SL:
            fits = self.fastest()
            slower = f", or {baud_text(fits)} at most" if fits else ""
            return f"no other master can share the bus at {at}: {why}; take an adapter that is faster{slower}"
        return (
            f"other masters need t_sl = {need} ({ms_text(params.ns(need))} at {at}) or more, this one has "
            f"{params.t_sl}: {why}; set t_sl on all of them"
        )

    def fastest(self) -> int:
        """The fastest baud rate at which a permitted T_SL is long enough; 0 for none."""
        return max((rate for rate in BAUD_RATES if self.at(rate).t_sl <= MAX_T_SL), default=0)

    def at(self, baud: int) -> Neighbours:
        """The needs at the rate ``baud``, with the bus parameters of its preset."""
        return Neighbours(BusParams.preset(baud, address=self.params.address), self.patience, self.lowest)


def _bits_up(ns: int, baud: int) -> int:
    return -(-ns * baud // NS_PER_S)
