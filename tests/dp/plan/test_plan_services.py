"""The plan's acyclic services against the wire: every kind and length, at every rate, within one bit time a telegram.

The slave is literal octets: it answers a request of any length with as many octets as the test says.
"""

from __future__ import annotations

import pytest
from octet_slave import DL, SC, sd2
from ring_bus import ListUser, RingBus

from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.telegram_times import acyclic_bits, exchange_bits, service_bits, service_octets
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import Req
from dpstack.params import BusParams
from dpstack.units import BAUD_RATES, NS_PER_S

LENGTHS = (0, 1, 16, 64, 128, 239, 240)
#: octets of data in request and answer of what has no record in it; None: acknowledged with SC
SHORT = {
    "empty poll": (0, None),
    "Read acknowledged": (4, None),
    "negative answer when polled": (0, 4),
    "Alarm_Ack": (4, 4),
    "Idle, both ways": (1, 1),
    "Slave_Diag": (0, 6),
}


def kinds(octets: int) -> dict[str, tuple[int, int | None]]:
    """Services with a record of so many octets."""
    return {
        "Read answered at once": (4, 4 + octets),
        "poll that fetches the answer": (0, 4 + octets),
        "Write answered at once": (4 + octets, 4),
        "Write acknowledged": (4 + octets, None),
        "Data_Transport answered at once": (4 + octets, 4 + octets),
        "Get_Cfg or Slave_Diag": (0, octets),
    }


class Wire:
    """A station alone with one slave, asked one service in each token hold. ``t_sdr`` None: it is silent, once it is
    known (a first request is never repeated).
    """

    def __init__(self, baud: int, t_sdr: int | None, t_sl: int | None = None) -> None:
        self.bus = RingBus(baud)
        self.user = ListUser()
        self.t_sdr = t_sdr
        self.answer: int | None = 0
        self.params = BusParams.preset(baud, address=2, gap=0, t_sl=t_sl)
        self.bus.slaves[4] = self._say
        self.bus.master(2, self.user, gap=0, t_sl=self.params.t_sl)
        self.bus.run_bits(12 * self.params.t_sl)  # T_TO is 10 of them
        self._known = False
        self.takes(0, None)
        self._known = True

    def _say(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
        if self.t_sdr is None:
            return None if self._known else (11, SC)
        if self.answer is None:
            return self.t_sdr, SC
        return self.t_sdr, sd2(2, 4, DL, 51, 51, bytes(self.answer))

    def takes(self, request: int, answer: int | None) -> int:
        """From the first bit of a service to that of the token after it, in ns."""
        self.answer = answer
        self.bus.log.clear()
        self.user.low.append(Request(4, Req.SRD_HIGH, bytes(request), 51, 51, patient=True))
        expected = len(self.user.results) + 1
        while len(self.user.results) < expected:
            self.bus.run_bits(3_000)
        self.bus.run_bits(3_000)
        begin = next(n for n, sent in enumerate(self.bus.log) if sent.octets[0] != 0xDC)
        after = next(sent for sent in self.bus.log[begin:] if sent.octets[0] == 0xDC)
        return after.start - self.bus.log[begin].start


def planned(params: BusParams, request: int, answer: int | None, tsdr: int) -> int:
    if answer is None:
        return params.ns(exchange_bits(params, service_octets(request), 1, tsdr))
    return params.ns(service_bits(params, request, answer, tsdr))


def hold(baud: int, lengths: range | tuple[int, ...], t_sdr: int) -> None:
    wire = Wire(baud, t_sdr)
    params = wire.params
    longest = params.ns(acyclic_bits(params))
    services = [kinds(octets) for octets in lengths]
    for name, (request, answer) in [*SHORT.items(), *(each for named in services for each in named.items())]:
        took = wire.takes(request, answer)
        assert abs(took - planned(params, request, answer, t_sdr)) <= 2 * params.ns(1), (name, request, answer)
        if "Transport" not in name:
            assert took <= longest + 2 * params.ns(1), name


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_every_kind_at_every_rate(baud: int) -> None:
    hold(baud, LENGTHS, BusParams.preset(baud).max_tsdr)


@pytest.mark.soak
@pytest.mark.parametrize("baud", BAUD_RATES)
def test_every_kind_with_every_length(baud: int) -> None:
    for t_sdr in (11, 60, BusParams.preset(baud).max_tsdr):
        hold(baud, range(241), t_sdr)


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_the_longest_service_is_a_write_of_240_octets_answered_at_once(baud: int) -> None:
    """To the bit, by hand: 255 and 15 characters."""
    params = BusParams.preset(baud)
    took = Wire(baud, params.max_tsdr).takes(244, 4)
    assert acyclic_bits(params) == 255 * 11 + params.max_tsdr + 15 * 11 + params.t_id1
    assert abs(took - params.ns(acyclic_bits(params))) <= 2 * params.ns(1)


@pytest.mark.parametrize("baud", BAUD_RATES)
@pytest.mark.parametrize("t_sl", [None, 10_115])
def test_silence_with_every_retry_is_in_the_longest(baud: int, t_sl: int | None) -> None:
    """A slave that exchanges data may be silent here; T_SL as beside masters on adapters outweighs any answer."""
    wire = Wire(baud, None, t_sl)
    params = wire.params
    tries = params.max_retry + 1
    took = wire.takes(244, None)
    by_hand = tries * (255 * 11 + max(params.t_sl, params.t_id1))
    assert abs(took - by_hand * NS_PER_S / baud) <= (tries + 1) * NS_PER_S / baud
    longest = acyclic_bits(params, retries=params.max_retry)
    assert longest >= by_hand
    assert (longest == by_hand) is (t_sl is not None)


def test_the_slowest_slave_counts() -> None:
    """MaxTsdr of a GSD file may be longer than the bus's max T_SDR, where T_SL was given."""
    params = BusParams.preset(500_000, t_sl=500)
    slow = SlaveParams(address=3, name="s", ident=1, config=b"\x10", max_tsdr={params.baud: 450})
    quick = SlaveParams(address=4, name="q", ident=1, config=b"\x10", max_tsdr={params.baud: 60})
    assert acyclic_bits(params, [quick]) == acyclic_bits(params)  # class 2 may ask others
    assert acyclic_bits(params, [quick, slow]) - acyclic_bits(params) == 450 - params.max_tsdr
