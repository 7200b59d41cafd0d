"""The fault of the matrix that is about data exchange broadcast: a publisher is lost, and its subscribers are not.

The publisher's inputs are numbers that exist only once. A subscriber must have the last number on the wire, or, once
that is older than its watchdog time, its safe octets; the octets of the master beside them go on.
"""

from __future__ import annotations

from bisect import bisect_right
from operator import itemgetter

from bus_kit import all_exchange
from faults.matrix import Fault
from support import MS, S

from dpstack.dp.master.commands import Mode, SetMode, Shutdown
from dpstack.dp.master.master import Master
from dpstack.dp.master.settings import MasterSettings
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.pdu.dxb import Link
from dpstack.dp.plan.rotation_time import Case, Figures
from dpstack.dp.slave.application import SlaveApp
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.dxb_links import DxbSupport
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.sim.world import World
from dpstack.trace import WireEntry

PUBLISHER, MASTER, IDENT = 20, 2, 0x0A35
#: four octets each way
CFG = b"\x13\x23"
ZEROS = bytes(4)
#: what the master sends, and what a subscriber has of it beside the two octets of the publisher
LIVE = b"\x11\x22\x33\x44"
SD2, TOKEN, TO_ALL, DATA = 0x68, 0xDC, 127, (0x08, 0x0A)
ROTATIONS = 60


class Counter(Device):
    """A publisher whose inputs count its exchanges."""

    ident, name, configs = IDENT, "publisher", (CFG,)
    dxb = DxbSupport(publisher=True)

    def __init__(self) -> None:
        self.count = 0

    def exchange(self, outputs: bytes, now: int) -> bytes:
        self.count += 1
        return self.count.to_bytes(4, "big")


class Follower(Device):
    """A subscriber that notes its outputs with their times."""

    ident, name, configs = IDENT, "subscriber", (CFG,)
    dxb = DxbSupport(links=1)

    def __init__(self) -> None:
        self.taken: list[tuple[int, bytes]] = []

    def exchange(self, outputs: bytes, now: int) -> bytes:
        self.taken.append((now, outputs))
        return outputs

    def clear(self, now: int) -> None:
        self.taken.append((now, ZEROS))

    def leave(self, reason: object, now: int) -> None:
        self.taken.append((now, ZEROS))


class Plant:
    """A publisher and subscribers, ``stations`` in all."""

    def __init__(self, baud: int, stations: int, seed: int) -> None:
        self.world = world = World(seed=seed, keep=1)
        self.broadcasts: list[tuple[int, bytes]] = []
        self.retries = 0
        self._last = b""
        world.log.listener = self._note
        dpv1 = Dpv1()
        common = {"ident": IDENT, "config": CFG, "user_prm": bytes(3), "dpv1": dpv1}
        setups = [SlaveParams(address=PUBLISHER, name="publisher", publishes=True, **common)]  # type: ignore[arg-type]
        links = (Link(PUBLISHER, 4, 2, 2, 2, 1),)
        others = range(PUBLISHER + 1, PUBLISHER + stations)
        setups += [SlaveParams(address=a, name=f"s{a}", links=links, **common) for a in others]  # type: ignore[arg-type]
        self.params = params = BusParams.preset(baud, address=MASTER, hsa=10)
        figures = Figures(params, setups)
        self.rotation_ns = figures.ns(Case.TYPICAL)
        self.watchdog_ns = figures.watchdog_ms() * MS
        self.publisher = self._station(PUBLISHER, Counter())
        self.followers = {address: Follower() for address in others}
        for address, device in self.followers.items():
            world.add(self._station(address, device))
        world.add(self.publisher)
        self.master = Master(params, setups, MasterSettings(watchdog_ms=figures.watchdog_ms()))
        self.station = ActiveStation(params, (self.master,), window=self.master.window, now=world.now)
        world.add(self.station)
        world.command(self.station, GoOnline())
        world.command(self.station, SetMode(Mode.OPERATE))
        for image in self.master.images.values():
            image.outputs = LIVE

    def _station(self, address: int, device: Device) -> PassiveStation:
        return PassiveStation(address, SlaveApp(device, address=address), self.params)

    def _note(self, entry: WireEntry) -> None:
        """Data of the publisher to all, and repeated requests."""
        octets = entry.octets
        is_request = entry.sender == str(MASTER) and octets[0] != TOKEN
        self.retries += is_request and octets == self._last
        self._last = octets if is_request else b""
        if (
            octets[0] == SD2
            and len(octets) == octets[1] + 6
            and octets[4:6] == bytes((TO_ALL, PUBLISHER))
            and octets[6] in DATA
        ):
            self.broadcasts.append((entry.end_ns, octets[7:-2]))

    @property
    def well(self) -> bool:
        now = self.broadcasts[-1][1][2:] if self.broadcasts else b""
        return all_exchange(self.master) and all(
            device.taken and device.taken[-1][1] == LIVE[:1] + now + LIVE[3:] for device in self.followers.values()
        )

    def until_well(self) -> int:
        """Rotations until all is well."""
        for passed in range(1, 100_000):
            self.world.run_for(self.rotation_ns)
            if self.well:
                return passed
        raise AssertionError("never well")

    def wrong(self, device: Follower) -> int:
        """Outputs that are neither those of the last broadcast in time nor safe."""
        taken = device.taken
        later = [*(outputs for _, outputs in taken[1:]), b""]
        return sum(not self._right(at, outputs, then) for (at, outputs), then in zip(taken, later, strict=True))

    def _right(self, at: int, outputs: bytes, later: bytes) -> bool:
        """``later``: the next outputs. A master that goes to Clear sends zeros, and Global_Control behind them."""
        if outputs in (ZEROS, LIVE[:1] + bytes(2) + LIVE[3:]):
            return True
        place = bisect_right(self.broadcasts, at, key=itemgetter(0)) - 1
        if place < 0:
            return False
        end, data = self.broadcasts[place]
        ending = later == ZEROS and outputs == ZEROS[:1] + data[2:] + ZEROS[3:]
        return at - end <= self.watchdog_ns and (ending or outputs == LIVE[:1] + data[2:] + LIVE[3:])

    def is_safe(self, device: Follower) -> bool:
        """Its last outputs have no value of a publisher."""
        return device.taken[-1][1][1:3] == bytes(2)


def lost_publisher(baud: int, stations: int, seed: int) -> dict[str, int | str]:
    """The publisher loses its power for two watchdog times, comes back, and is lost again as the bus ends."""
    plant = Plant(baud, stations, seed)
    world, app = plant.world, plant.publisher.responder
    assert isinstance(app, SlaveApp)
    plant.until_well()
    plant.retries = 0

    def lose() -> None:
        world.remove(plant.publisher)
        app.restart(world.now)

    lose()
    before = {address: len(device.taken) for address, device in plant.followers.items()}
    world.run_for(max(2 * plant.watchdog_ns, ROTATIONS * plant.rotation_ns))
    exchanges = sum(len(device.taken) - before[address] for address, device in plant.followers.items())
    safe = sum(plant.is_safe(device) for device in plant.followers.values())
    assert safe == len(plant.followers)
    world.add(plant.publisher)
    back = plant.until_well()
    lose()
    world.run_for(3 * plant.rotation_ns)
    world.command(plant.station, Shutdown())
    world.run_for(plant.watchdog_ns + 2 * S)
    assert world.referee is not None
    ends = sum(device.taken[-1][1] == ZEROS for device in plant.followers.values())
    return {
        "exchanges": exchanges,
        "retries": plant.retries,
        "wrong data": sum(plant.wrong(device) for device in plant.followers.values()),
        "back after": back,
        "last octets": f"{ends} x zeros",
        "referee": len(world.referee.violations),
    }


BROADCAST_FAULTS = [
    Fault(
        name="a publisher is lost",
        measure=lost_publisher,
        rates=(500_000, 1_500_000, 12_000_000),
        stations=(8,),
        quick=((500_000, 8),),
    )
]
