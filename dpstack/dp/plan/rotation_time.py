"""The bus rotation time from the telegrams as they are really sent; T_TR and the watchdog that follow from it.

All slaves are in data exchange: for each of them Data_Exchange, T_SDR, the answer, T_ID1; then the token and T_ID1.
With rate groups the emptiest round with a slave makes the shortest rotation, the fullest round the others. Other
masters have their turn before the token is back.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import Enum
from typing import Final

from msgspec import Struct
from msgspec.structs import force_setattr

from dpstack.dp.rate_groups import Share, emptiest, fullest, idle_rounds, offsets, round_interval_ns
from dpstack.dp.slave_params import MAX_WATCHDOG_MS, SlaveParams
from dpstack.dp.telegram_times import (
    acyclic_bits,
    data_bits,
    diagnosis_bits,
    gap_poll_bits,
    global_control_bits,
    longest_tsdr,
    share,
    shortest_tsdr,
    token_bits,
)
from dpstack.params import BusParams
from dpstack.units import NS_PER_MS, NS_PER_S

#: T_SDR of a usual slave ASIC, for the typical rotation
TYPICAL_TSDR: Final = 60
MIN_WATCHDOG_MS: Final = 200
MIN_WATCHDOG_PTY_MS: Final = 1000
MAX_T_TR: Final = 16_777_960


class Case(Enum):
    SHORTEST = "min"  # every T_SDR at its minimum, nothing but data exchange and token
    TYPICAL = "typical"  # T_SDR 60 bit times, one silent GAP poll when the GAP is on
    NORMAL = "normal"  # the longest without a repetition: T_SDR at its maximum, one diagnosis, Global_Control, GAP
    LONGEST = "max"  # that with every retry, and one acyclic service


class OtherMasters(Struct, frozen=True):
    """The other masters of the bus. ``alike``: number of those that need as long as this one; ``rounds``: of each
    further one its bus rotation time in bit times when it is alone on the bus.
    """

    alike: int = 0
    rounds: tuple[int, ...] = ()

    @property
    def count(self) -> int:
        return self.alike + len(self.rounds)


ALONE: Final = OtherMasters()


class Rotation(Struct, frozen=True, kw_only=True):
    """A rotation in bit times. ``slaves``: the time of each slave in its rounds, with T_ID1 after its answer;
    ``together``: the slaves in the fullest round.

    ``bits``: from the first Data_Exchange of a round to the first one after that round. In the shortest case the round
    is the emptiest one and no idle round follows; in the others it is the fullest one, and all of them follow.
    """

    slaves: dict[int, int]
    together: frozenset[int]
    #: time of the slaves in the fullest round
    data: int
    #: time of services, Global_Control and GAP poll
    beside: int
    #: time until the next station has the token
    token: int
    #: time of the other masters
    others: int
    #: waiting for Min_Slave_Interval while the token goes round
    waiting: int
    #: most rounds without any slave, one after the other
    idle: int
    bits: int

    @property
    def work(self) -> int:
        """The fullest round without waiting: the earliest return of the token."""
        return self.data + self.beside + self.token + self.others

    @property
    def hold(self) -> int:
        """The token hold of this master in it."""
        return self.data + self.beside


def rotation(params: BusParams, setups: Sequence[SlaveParams], case: Case, others: OtherMasters = ALONE) -> Rotation:
    """The bus rotation time with every slave of ``setups`` in data exchange, of other masters too as in ``case``."""
    retries = params.max_retry if case is Case.LONGEST else 0
    slaves = {s.address: data_bits(params, s, tsdr_bits(params, s, case), retries) for s in setups}
    groups = [Share(s.address, s.every, slaves[s.address]) for s in setups]
    chosen = rate_offsets(params, setups)
    together = fullest(groups, chosen)
    data = sum(slaves[address] for address in together)
    beside, token = _beside(params, setups, case), token_bits(params)
    theirs = others.alike * (data + beside + token) + sum(others.rounds)
    needs = data + beside + token + theirs
    # in bit times, up to the next one
    interval = -(-round_interval_ns((s.every, s.min_slave_interval_ns) for s in setups) * params.baud // NS_PER_S)
    if case is Case.SHORTEST:
        waiting, idle = max(0, interval - needs), 0
        least = sum(slaves[address] for address in emptiest(groups, chosen))
        # a slave that follows others in one round and is the first in the next waits before that round's first request
        ahead = sum(data_bits(params, s, longest_tsdr(params, s)) for s in setups if s.every > 1)
        bits = max(interval - ahead, needs - (1 + others.alike) * (data - least))
    else:
        idle = idle_rounds(groups, chosen)
        empty = needs - data
        if case is Case.TYPICAL:
            # a round begins with the first token after the interval; until then the token goes round
            turn = token * (1 + others.count)
            waiting = -(-max(0, interval - needs) // turn) * turn
            empty += -(-max(0, interval - empty) // turn) * turn
        else:
            # the last hold before the round may still have what stands beside the data
            waiting = max(0, interval - data)
            empty += interval
        bits = needs + waiting + idle * empty
    return Rotation(
        slaves=slaves,
        together=together,
        data=data,
        beside=beside,
        token=token,
        others=theirs,
        waiting=waiting,
        idle=idle,
        bits=bits,
    )


def rate_offsets(params: BusParams, setups: Sequence[SlaveParams]) -> dict[int, int]:
    """The offsets of the rounds in which the slaves of ``setups`` have their turn (:mod:`dpstack.dp.rate_groups`)."""
    return offsets(share(params, s) for s in setups)


def _beside(params: BusParams, setups: Sequence[SlaveParams], case: Case) -> int:
    if case is Case.SHORTEST:
        return 0
    bits = gap_poll_bits(params)
    if case is not Case.TYPICAL:
        retries = params.max_retry if case is Case.LONGEST else 0
        bits += longest_diagnosis(params, setups, retries) + global_control_bits(params)
        bits += acyclic_bits(params, setups, retries) if case is Case.LONGEST else 0
    return bits


def longest_diagnosis(params: BusParams, setups: Sequence[SlaveParams], retries: int = 0) -> int:
    """The longest Slave_Diag of all in bit times; 0 without slaves."""
    return max((diagnosis_bits(params, s, retries) for s in setups), default=0)


def tsdr_bits(params: BusParams, setup: SlaveParams, case: Case) -> int:
    """T_SDR of a slave in ``case``, in bit times."""
    shortest, longest = shortest_tsdr(params, setup), longest_tsdr(params, setup)
    if case is Case.SHORTEST:
        return shortest
    return max(shortest, min(TYPICAL_TSDR, longest)) if case is Case.TYPICAL else longest


class Figures(Struct, frozen=True):
    """The rotations of one bus at one rate. ``setups`` are sorted by address; ``cycle_ns`` 0: free running;
    ``host_slack_ns``: greatest delay of a known station's answer after the deadline of the wire.
    """

    #: bus parameters
    params: BusParams
    #: parameters of the slaves, sorted by address
    setups: Sequence[SlaveParams]
    #: the other masters of the bus
    others: OtherMasters = ALONE
    #: fixed cycle in ns; 0: free running
    cycle_ns: int = 0
    host_slack_ns: int = 0
    #: the rotation in each case, in bit times
    rotations: dict[Case, Rotation] = {}

    def __post_init__(self) -> None:
        setups = tuple(sorted((s.on_bus(self.params) for s in self.setups), key=lambda s: s.address))
        force_setattr(self, "setups", setups)
        rotations = {case: rotation(self.params, setups, case, self.others) for case in Case}
        force_setattr(self, "rotations", rotations)

    def ns(self, case: Case) -> int:
        """A rotation in nanoseconds (:attr:`Rotation.bits`)."""
        return self.params.ns(self.rotations[case].bits)

    def full_ns(self, case: Case) -> int:
        """The fullest round in nanoseconds."""
        return self.params.ns(self.rotations[case].work + self.rotations[case].waiting)

    def work_ns(self, case: Case) -> int:
        """The same without waiting for Min_Slave_Interval."""
        return self.params.ns(self.rotations[case].work)

    def data_ns(self, case: Case) -> int:
        """The same without services, Global_Control and GAP poll."""
        return self.params.ns(self.rotations[case].work - self.rotations[case].beside)

    @property
    def acyclic_bits(self) -> int:
        """The longest time by which one acyclic service without repetition makes a rotation longer."""
        return acyclic_bits(self.params, self.setups)

    @property
    def spacing_ns(self) -> int:
        """The longest time from round to round."""
        return self.round_ns(Case.LONGEST)

    def round_ns(self, case: Case) -> int:
        """The time from the fullest round to the next one: with a fixed cycle whole cycles."""
        takes = self.full_ns(case)
        return -(-takes // self.cycle_ns) * self.cycle_ns if self.cycle_ns else takes

    def between_ns(self, case: Case) -> int:
        """The time from a round with slaves to the next one: with a fixed cycle whole cycles, the delays of their
        beginnings aside."""
        return self.round_ns(case) + self.rotations[case].idle * self.cycle_ns if self.cycle_ns else self.ns(case)

    @property
    def dying_ns(self) -> int:
        """The time in which all wait for a slave that dies, beyond the longest rotation; 0 without host slack."""
        slack = self.host_slack_ns
        return (self.params.max_retry + 1) * (self.params.ns(self.params.t_sl) + slack) if slack else 0

    @property
    def normal_with_services(self) -> int:
        """The longest normal rotation in bit times with one acyclic service in the hold of every master."""
        return self.rotations[Case.NORMAL].work + (1 + self.others.count) * self.acyclic_bits

    @property
    def t_tr_needed(self) -> int:
        """T_TR in bit times with which every master can end its longest normal round and one acyclic service in each
        hold.

        T_TH is T_TR - T_RR: after a full token rotation there must be time left for the longest hold of all. The
        service of another master is as long as the longest of this one.
        """
        normal = self.rotations[Case.NORMAL]
        longest = max(normal.hold, *(bits - normal.token for bits in self.others.rounds), 0)
        return min(self.normal_with_services + longest + self.acyclic_bits, MAX_T_TR)

    @property
    def t_tr_preset(self) -> int:
        """T_TR in bit times for this configuration: the table's, or what the masters need if that is more."""
        return max(self.params.t_tr, self.t_tr_needed)

    def watchdog_ms(self, *, pty: bool = False) -> int:
        """The recommended watchdog: three times what can pass until a slave has its turn again, at least 200 ms
        (1000 ms on ptys), in 10 ms steps.

        While one slave dies the others wait for its slot time and the host's slack, with every retry: part of it.
        """
        every = max((s.every for s in self.setups if s.watchdog_ms is None), default=1)
        steps = -(-3 * (self.spacing_ns * every + self.dying_ns) // (10 * NS_PER_MS))
        return min(max(MIN_WATCHDOG_PTY_MS if pty else MIN_WATCHDOG_MS, steps * 10), MAX_WATCHDOG_MS)
