"""A token ring under fire: several masters in one world, with or without slaves of their own, and when it has healed.

*Quiet*: from now on no token is lost, repeated or claimed, nobody withdraws, nobody leaves the ring.
*Healed*: quiet, and all masters that were in the ring when the trouble ended still share one token and one LAS.
*Whole*: every master that is switched on is in the ring, and each one's LAS says so.
"""

from __future__ import annotations

from bus_kit import add_station, all_exchange, mirror, setup
from support import WorldFactory

from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.fdl.active.states import State
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.fdl.events import RingJoined, RingLeft, TokenLost
from dpstack.fdl.interface import LinkUser
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.telegram import Kind
from dpstack.params import BusParams
from dpstack.sim.referee import Referee
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from dpstack.trace import Event
from dpstack.units import BITS_PER_CHAR

#: the slave of master n has this address: above HSA, so that no GAP poll asks for it
SLAVE_OF = 100


class FireRing:
    """Masters ``addresses`` in ``world``, all with ``params`` but the address; ``slaves``: each has one to serve."""

    def __init__(
        self,
        world: World,
        params: BusParams,
        addresses: tuple[int, ...],
        *,
        slaves: bool = False,
        watchdog_ms: int = 200,
    ) -> None:
        self.world = world
        self.params = params
        self.with_slaves = slaves
        self._watchdog_ms = watchdog_ms
        self.masters: dict[int, ActiveStation] = {}
        self.dp: dict[int, Master] = {}
        self.slaves: dict[int, PassiveStation] = {}
        self.events: list[Event] = []
        self.switched_off: list[ActiveStation] = []
        for address in addresses:
            self.join(address)

    # --- what can happen to a ring ---
    def join(self, address: int, *users: LinkUser) -> ActiveStation:
        """Switch a new master on."""
        params = self.params.replace(address=address)
        if self.with_slaves:
            users = (self._plant(address, params), *users)
        self.masters[address] = station = add_station(self.world, params, *users, on_events=self.events.extend)
        return station

    def _plant(self, address: int, params: BusParams) -> Master:
        slave = SLAVE_OF + address
        if slave not in self.slaves:
            self.slaves[slave] = mirror(slave, params)
            self.world.add(self.slaves[slave])
        self.dp[address] = Master(params, [setup(slave)], MasterSettings(watchdog_ms=self._watchdog_ms))
        return self.dp[address]

    def die(self, address: int) -> ActiveStation:
        """Switch a master off, in the middle of a telegram too."""
        station = self.masters.pop(address)
        self.dp.pop(address, None)
        self.world.remove(station)
        self.switched_off.append(station)
        return station

    def leave(self, address: int) -> None:
        """An ordered end of the link layer; the station stays plugged in."""
        self.world.command(self.masters[address], GoOffline())

    def back(self, address: int) -> None:
        """Online again."""
        self.world.command(self.masters[address], GoOnline())

    def drop_tokens(self, times: int, sender: str | None = None) -> None:
        """The next ``times`` tokens (of ``sender``) get lost."""
        self.world.faults.drop(lambda tx: is_token(tx) and sender in (None, tx.sender), times=times)

    @property
    def referee(self) -> Referee:
        assert self.world.referee is not None
        return self.world.referee

    # --- time ---
    def run_bits(self, bits: int) -> None:
        self.world.run_for(self.params.ns(bits))

    def until(self, condition: object, within_bits: int = 200_000) -> None:
        """Run event by event until ``condition()`` is true."""
        assert callable(condition)
        end = self.world.now + self.params.ns(within_bits)
        while not condition():
            assert self.world.now < end, "did not happen in time"
            self.world.step()

    def run_rotations(self, count: int) -> None:
        """Until some master has been given the token ``count`` times."""
        watched = next(iter(self.masters.values()))
        goal = watched.stats.tokens + count
        self.until(lambda: watched.stats.tokens >= goal, count * 100_000)

    # --- the judgement ---
    @property
    def trouble(self) -> tuple[int, ...]:
        """Grows with every sign of a ring that is not sound."""
        stats = [station.stats for station in self.masters.values()]
        told = sum(isinstance(event, RingLeft | TokenLost) for event in self.events)
        claims = sum(isinstance(event, RingJoined) and event.claimed for event in self.events)
        return (
            told,
            claims,
            sum(s.tokens_lost for s in stats),
            sum(s.token_retries for s in stats),
            sum(s.withdrawn for s in stats),
        )

    @property
    def whole(self) -> bool:
        everybody = set(self.masters)
        return all(station.in_ring and station.las == everybody for station in self.masters.values())

    @property
    def one_ring(self) -> bool:
        """The members have each other in their LAS, and nobody else but who was found ready and waits for the token."""
        members = {address for address, station in self.masters.items() if station.in_ring}
        waiting = {address for address, station in self.masters.items() if station.state is State.ACTIVE_IDLE}
        return bool(members) and all(members <= self.masters[a].las <= members | waiting for a in members)

    @property
    def exchanging(self) -> bool:
        """Every master's slave is in data exchange."""
        return all(map(all_exchange, self.dp.values()))


def is_token(tx: Transmission) -> bool:
    return tx.telegram is not None and tx.telegram.kind is Kind.SD4


# --- the bounds, in bit times ---------------------------------------------------------------------------------------
#: SD1 and the token in bit times
SD1_BITS = 6 * BITS_PER_CHAR
TOKEN_BITS = 3 * BITS_PER_CHAR


def rotation_bits(params: BusParams, masters: int, traffic: int = 0) -> int:
    """One token rotation in which every hold has ``traffic`` and one silent GAP poll."""
    hold = traffic + SD1_BITS + params.t_id1 + params.t_sl + TOKEN_BITS + params.t_id1
    return masters * hold


def healing_bits(params: BusParams, highest: int, masters: int, traffic: int = 0) -> int:
    """T_TO of the highest address + three token rotations + HSA x T_SL."""
    t_to = params.replace(address=highest).t_to
    return t_to + 3 * rotation_bits(params, masters, traffic) + params.hsa * params.t_sl


def inclusion_bits(params: BusParams, masters: int, traffic: int = 0) -> int:
    """Until a master that listens in a sound ring is a member of it.

    It learns the LAS (three rotations), waits for the next GAP pass (G x T_TR, or the pass under way), and the pass
    polls one address a hold.
    """
    rotation = rotation_bits(params, masters, traffic)
    a_pass = (params.hsa + 1) * rotation
    return 3 * rotation + max(params.gap * params.t_tr, a_pass) + a_pass


def fire_params(baud: int = 500_000, **changes: int) -> BusParams:
    """A small HSA, and GAP passes that follow each other closely."""
    return BusParams.preset(baud, address=0).replace(**{"hsa": 20, "gap": 1, "t_tr": 5_000, **changes})


def make_ring(
    make: WorldFactory, *addresses: int, slaves: bool = False, seed: int = 0, baud: int = 500_000, **changes: int
) -> FireRing:
    """A ring that is whole, its slaves in data exchange; the referee is on."""
    ring = FireRing(make(seed=seed), fire_params(baud, **changes), addresses, slaves=slaves)
    ring.until(lambda: ring.whole and ring.exchanging, 3_000_000)
    return ring
