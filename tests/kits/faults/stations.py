"""Faults of the fault matrix that are a station: a babbler, slaves without power, a second master, a taken address."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from faults.matrix import Begin, End, Fault
from faults.plant import FIRST_MASTER, Plant
from faults.truth import FUNCTION, REQUEST, SRD, Device, fields
from faults.wire import FEWER_RATES, LOW_RATES
from foreign_master import SLOT_BITS, ForeignMaster, fdl_status
from slave_kit import make_slave
from support import MS, S

from dpstack.dp.master.master import Master
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOffline, GoOnline
from dpstack.trace import WireEntry
from dpstack.units import chars_to_ns

SLAVE_DIAG, SET_PRM, CHK_CFG = 60, 61, 62
#: the address of a second master: between the first one and HSA
SECOND_MASTER = 5
ABSENT = 100
#: octets of a babbler at most, and of a jabber in one piece
BABBLE, JABBER = 20, 200
#: so often a slave restarts at one step of its bring-up
REBOOTS = 3
RESUME: Mapping[str, Any] = {"safe_after_stall": False}


def babbler(plant: Plant) -> End:
    """A station sends up to 20 octets by chance, on average in every second rotation, whoever is sending."""
    on = True

    def babble() -> None:
        if on:
            plant.inject(plant.rng.randbytes(plant.rng.randint(1, BABBLE)))
            plant.after(1 + round(plant.rng.expovariate(1 / (2 * plant.rotation_ns))), babble)

    def end() -> None:
        nonlocal on
        on = False

    babble()
    return end


def jabber(plant: Plant) -> End:
    """A station sends without end for two watchdog times: no token, no request comes through."""
    until = plant.world.now + 2 * plant.watchdog_ns
    on = True

    def go_on() -> None:
        if on and plant.world.now < until:
            plant.inject(plant.rng.randbytes(JABBER))
            plant.after(chars_to_ns(JABBER, plant.params.baud), go_on)

    def end() -> None:
        nonlocal on
        on = False

    go_on()
    return end


def dip(ns: Callable[[Plant], int]) -> Begin:
    """All slaves lose their power at once, for so long."""

    def begin(plant: Plant) -> End:
        off = list(plant.stations)

        def switch_on() -> None:
            while off:
                plant.switch_on(off.pop())

        for address in plant.stations:
            plant.switch_off(address)
        plant.after(ns(plant), switch_on)
        return switch_on

    return begin


def reboot_after(step: int) -> Begin:
    """A slave restarts as it has answered its ``step``-th request since it was switched on, three times.

    Its bring-up: 1 Slave_Diag, 2 Set_Prm, 3 Chk_Cfg, 4 Slave_Diag, then Data_Exchange.
    """

    def begin(plant: Plant) -> End:
        address, off, asked, answered, reboots = plant.victim, False, False, 0, 0

        def restart() -> None:
            nonlocal off, answered
            if not off:
                off, answered = True, 0
                plant.switch_off(address)
                plant.after(2 * plant.rotation_ns, switch_on)

        def switch_on() -> None:
            nonlocal off
            if off:
                off = False
                plant.switch_on(address)

        def watch(entry: WireEntry) -> None:
            nonlocal asked, answered, reboots
            parts = fields(entry.octets)
            if parts is not None and parts[2] & REQUEST:
                asked = parts[0] == address and parts[2] & FUNCTION in SRD
            elif asked and entry.sender == str(address):
                asked, answered = False, answered + 1
                if answered == step and reboots < REBOOTS and not off:
                    reboots += 1
                    plant.after(1, restart)

        def end() -> None:
            plant.truth.watch.remove(watch)
            switch_on()

        plant.truth.watch.append(watch)
        restart()
        return end

    return begin


def second_master(*, sudden: bool) -> Begin:
    """A master without slaves joins the ring, stays for five rotations and leaves it, or vanishes; again and again."""

    def begin(plant: Plant) -> End:
        world, params = plant.world, plant.params.replace(address=SECOND_MASTER)
        on, stayed = True, 0
        station = ActiveStation(params, (Master(params),), now=world.now)
        present = True
        world.add(station)
        world.command(station, GoOnline())

        def every_rotation() -> None:
            nonlocal stayed, station, present
            if not on:
                return
            stayed = stayed + 1 if present and station.in_ring else 0
            if not present:
                present = True
                if sudden:
                    station = ActiveStation(params, (Master(params),), now=world.now)
                    world.add(station)
                world.command(station, GoOnline())
            elif stayed > 5:
                present, stayed = False, 0
                leave()
            plant.after(plant.rotation_ns, every_rotation)

        def leave() -> None:
            if sudden:
                world.remove(station)
            else:
                world.command(station, GoOffline())

        def end() -> None:
            nonlocal on
            on = False
            if not sudden:
                world.command(station, GoOffline())
                plant.after(20 * plant.rotation_ns, lambda: world.remove(station))
            elif present:
                world.remove(station)

        every_rotation()
        return end

    return begin


def token_hog(plant: Plant) -> End:
    """A master that is not ours gets the token and polls an absent address for longer than the slaves' watchdogs."""
    polls = round(1.2 * plant.watchdog_ns / plant.params.ns(6 * 11 + SLOT_BITS)) + 1
    hog = ForeignMaster(
        SECOND_MASTER,
        FIRST_MASTER,
        says=(fdl_status(ABSENT, SECOND_MASTER),) * polls,
        holds=1,
        baud=plant.params.baud,
    )
    plant.world.add(hog)
    return lambda: plant.world.remove(hog)


def twin_slave(plant: Plant) -> End:
    """A second slave has the address of another one, and answers later."""
    address = plant.victim
    device = Device(address, 0xB0)
    plant.devices[address].append(device)
    twin = make_slave(address, device, plant.params, t_sdr=30)
    plant.world.add(twin, name="twin")
    return lambda: plant.world.remove(twin)


def twin_master(plant: Plant) -> End:
    """A second master with the same address is switched on in the middle of the traffic."""
    params = plant.params
    station = ActiveStation(params, (Master(params),), now=plant.world.now)
    plant.world.add(station, name=f"second {FIRST_MASTER}")
    plant.world.command(station, GoOnline())
    return lambda: plant.world.remove(station)


STEPS = {
    "Slave_Diag": 1,
    "Set_Prm": 2,
    "Chk_Cfg": 3,
    "the second Slave_Diag": 4,
    "the first Data_Exchange": 5,
    "the tenth Data_Exchange": 14,
}
#: long enough for every watchdog at the higher rates
LONG_DIP = 500 * MS
#: at 12 Mbit/s two watchdog times are 400 000 octets of noise, which tell no more than those at 1.5 Mbit/s
JABBER_RATES = (9_600, 45_450, 500_000, 1_500_000)

STATION_FAULTS = [
    Fault(name="babbler", begin=babbler, quick=((45_450, 8), (500_000, 1), (12_000_000, 8))),
    Fault(name="jabber", begin=jabber, rates=JABBER_RATES, rotations=4, quick=((9_600, 1),)),
    Fault(name="jabber", begin=jabber, rates=(500_000,), rotations=4, settings=RESUME),
    *(
        Fault(
            name=f"reboot after {name}",
            begin=reboot_after(step),
            rates=FEWER_RATES,
            quick=((9_600, 8),) if step % 2 else ((500_000, 1),),
        )
        for name, step in STEPS.items()
    ),
    Fault(
        name="power dip of all, 2 rotations",
        begin=dip(lambda plant: 2 * plant.rotation_ns),
        rates=FEWER_RATES,
        quick=((500_000, 8),),
    ),
    Fault(
        name="power dip of all, 500 ms",
        begin=dip(lambda _: LONG_DIP),
        least_ns=S,
        rates=LOW_RATES,
        quick=((9_600, 1), (45_450, 8)),
    ),
    Fault(
        name="power dip of all, half a rotation",
        begin=dip(lambda plant: plant.rotation_ns // 2),
        rates=FEWER_RATES,
        quick=((500_000, 8), (9_600, 1)),
    ),
    Fault(
        name="power dip of all, half a rotation",
        begin=dip(lambda plant: plant.rotation_ns // 2),
        settings=RESUME,
        rates=(500_000,),
        quick=((500_000, 8),),
    ),
    *(
        Fault(
            name="a master keeps the token for 1.2 watchdog times",
            begin=token_hog,
            settings=settings,
            rates=FEWER_RATES,
            rotations=5,
            quick=((9_600, 1),),
        )
        for settings in ({}, RESUME)
    ),
    *(
        Fault(name=name, begin=begin, masters=3, stations=(3,), rates=FEWER_RATES)
        for name, begin in (("babbler", babbler), ("a master joins and vanishes", second_master(sudden=True)))
    ),
    Fault(name="a master joins and leaves", begin=second_master(sudden=False), quick=((500_000, 8), (9_600, 1))),
    Fault(name="a master joins and vanishes", begin=second_master(sudden=True), quick=((500_000, 1), (45_450, 8))),
    Fault(name="two slaves with one address", begin=twin_slave, rates=FEWER_RATES, quick=((9_600, 8), (500_000, 1))),
    Fault(
        name="two masters with one address", begin=twin_master, rates=FEWER_RATES, quick=((500_000, 8), (12_000_000, 1))
    ),
]
