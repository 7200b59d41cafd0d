"""Long runs at every baud rate in virtual time with the referee on the wire: 2 000 exchanges here, 100 000 in soak."""

from __future__ import annotations

import pytest
from bus_kit import SimBus
from support import S, WorldFactory

from dpstack.params import BusParams
from dpstack.units import BAUD_RATES, bits_to_ns

#: so many exchanges between two changes of the outputs
_STRIDE = 100


def endure(world: WorldFactory, baud: int, exchanges: int) -> None:
    """``exchanges`` with two slaves, GAP polls among them; every answer carries the outputs of the exchange before."""
    bus = SimBus(world(), BusParams.preset(baud, address=2), [5, 100])
    bus.until_exchanging(within_ns=100 * S)
    handlers = list(bus.master.handlers.values())
    begun = sum(h.exchanges for h in handlers)
    pattern = 0
    # room for any exchange of this size and a GAP poll
    stride_ns = _STRIDE * bits_to_ns(2_000, baud)
    while (done := sum(h.exchanges for h in handlers) - begun) < exchanges:
        pattern = pattern * 5 + 1 & 0xFF
        for handler in handlers:
            handler.image.outputs = bytes([pattern, handler.setup.address] * 6)
        bus.world.run_for(stride_ns)
        assert sum(h.exchanges for h in handlers) - begun > done
        for handler in handlers:
            assert handler.image.inputs == bytes([pattern, handler.setup.address] * 6)
    assert bus.exchanging
    assert bus.station.stats.tokens_lost == 0
    assert all(s.retries == s.timeouts == s.late == 0 for a, s in bus.station.stats.stations.items() if a in (5, 100))
    assert bus.station.decoder_stats.bad == 0


@pytest.mark.parametrize("baud", BAUD_RATES)
def test_2000_exchanges_at_every_rate(world: WorldFactory, baud: int) -> None:
    endure(world, baud, 2_000)


@pytest.mark.soak
@pytest.mark.parametrize("baud", BAUD_RATES)
def test_100_000_exchanges_at_every_rate(world: WorldFactory, baud: int) -> None:
    endure(world, baud, 100_000)
