"""The active station in the simulated world, with the referee watching."""

from __future__ import annotations

import pytest
from bus_kit import add_station
from ring_bus import ListUser
from support import MS, WorldFactory

from dpstack.fdl.interface import SC_REPLY, Reply, Request, Responder
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Req, Resp, StationType, Telegram
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.units import BAUD_RATES


class Echo(Responder):
    """An application that answers with the octets of the request."""

    def serve(self, request: Telegram, now: int) -> Reply | None:
        return Reply(Resp.DL, request.data) if request.data else SC_REPLY


def dx(address: int, n: int = 0) -> Request:
    return Request(address, Req.SRD_HIGH, bytes((n, 0x55)), patient=True)


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_exchange_and_gap_at_every_rate(w: World, baud: int) -> None:
    params = BusParams.preset(baud, address=2, hsa=8, gap=1, t_tr=20_000)
    user = ListUser(per_hold=[dx(4, n) for n in range(3)])
    station = add_station(w, params, user)
    w.add(PassiveStation(4, Echo(), params))
    w.run_for(params.ns(120_000))
    assert station.stations == {4: StationType.SLAVE}
    assert len(user.results) > 50
    assert all(isinstance(o, Telegram) and o.data == r.data for r, o, _ in user.results)
    assert station.stats.ignored == 0


@pytest.mark.parametrize("seed", range(6))
def test_noise_is_survived(world: WorldFactory, seed: int) -> None:
    w = world(seed=seed, referee=False)
    params = BusParams.preset(1_500_000, address=2, hsa=10, t_tr=20_000, gap=1)
    users = [ListUser(per_hold=[dx(20)]) for _ in range(3)]
    masters = [add_station(w, params.replace(address=a), u) for a, u in zip((2, 5, 9), users, strict=True)]
    w.add(PassiveStation(20, Echo(), params))
    w.run_for(100 * MS)
    w.faults.noise(1e-3)
    w.run_for(300 * MS)
    w.faults.noise(0.0)
    w.run_for(200 * MS)
    assert [m.las for m in masters] == [{2, 5, 9}] * 3
    for user in users:
        assert all(o.data == r.data for r, o, _ in user.results if isinstance(o, Telegram))


@pytest.mark.parametrize("delay", [210, 250, 300, 330, 400, 700])
def test_late_slaves(world: WorldFactory, delay: int) -> None:
    """A slave slower than T_SL: its answers meet whatever comes next; nothing is ever taken for something else."""
    w = world(referee=False)
    params = BusParams.preset(500_000, address=2, gap=0)
    user = ListUser(per_hold=[dx(4, 1), dx(4, 2), *(dx(5, n) for n in range(4))])
    station = add_station(w, params, user)
    w.add(PassiveStation(4, Echo(), params, t_sdr=delay))
    w.add(PassiveStation(5, Echo(), params))
    w.run_for(100 * MS)
    for request, outcome, _ in user.results:
        if isinstance(outcome, Telegram):
            assert (outcome.sa, outcome.data) == (request.da, request.data)
    assert sum(isinstance(o, Telegram) for r, o, _ in user.results if r.da == 5) > 10
    assert station.in_ring
