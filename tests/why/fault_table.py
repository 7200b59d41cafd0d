"""The table of faults, written from what each plant does and apart from any diagnosis.

``FAULTS``: the 25 faults; ``FURTHER``: five more; ``HEALTHY``: five plants without a fault of the slave asked about;
``PAIRS``: five pairs of faults at once, where either cause may be first and both are wanted. Each is a function of a
seed, which chooses addresses, rate, neighbours, traffic of another master, and the place of the fault.

Names of modules: ``module_missing``: a module of the configuration is not in the rack; ``module_extra``: a module of
the rack is not in the configuration; ``module_type``: in one slot there is another module; ``module_order``: the same
modules in other slots.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from random import Random
from typing import Final

from faults.devices import Babbler, DpV0Only, Hasty, Ill, NeedsDpV1, Picky, RefusesService, RudeMaster, Share
from faults.slaves import NeverReady, WrongLength, locked_by

from dpstack.api.config.config import slave_config
from dpstack.api.config.slave import SlaveConfig
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import SAP_CHK_CFG, SAP_SET_PRM, SAP_SLAVE_DIAG
from dpstack.gsd.identifiers import io_lengths
from dpstack.units import BAUD_RATES
from tests.why.fault_plants import IO_MODULES, MS, RATES, TERMINAL_MODULES, Plant, Table, Unit

MakePlant = Callable[[int], Plant]
Equip = Callable[[Plant], None]
Plants = dict[str, MakePlant]
#: rates for plants that need longer
SLOW: Final = (45_450, 93_750, 187_500, 500_000)
FAULTS: Final[Plants] = {}
FURTHER: Final[Plants] = {}
HEALTHY: Final[Plants] = {}
PAIRS: Final[Plants] = {}


def plant_of(table: Plants, *causes: str, rates: Sequence[int] = tuple(RATES)) -> Callable[[Equip], Equip]:
    """Enter into ``table`` the plants that a function builds; without ``causes`` their cause is called as they are."""

    def enter(build: Equip) -> Equip:
        name = build.__name__

        def make(seed: int) -> Plant:
            plant = Plant(name, seed, causes or [name], every=table is PAIRS, rates=rates)
            build(plant)
            return plant

        table[name] = make
        return build

    return enter


def mirror_of(slave: SlaveConfig) -> MirrorDevice:
    """A slave that accepts the configuration of ``slave``, and any user parameters."""
    return MirrorDevice(slave.params.ident or 0, slave.params.config, slave.name)


# --- nobody answers at the address --------------------------------------------------------------------------------


@plant_of(FAULTS, "not_there")
def no_power(plant: Plant) -> None:
    """The slave has no power; its neighbours run."""
    plant.ask_any()
    plant.surrounded()


@plant_of(FURTHER, "not_there")
def wires_open(plant: Plant) -> None:
    """The cable is torn: this slave and one or two behind it are cut off, those before it run."""
    plant.ask_any()
    beside = plant.neighbours(2, 5)
    for unit in beside[1 : 1 + plant.rng.randint(1, 2)]:
        plant.unplug(unit)


@plant_of(FAULTS, "not_there")
def deaf_at_rate(plant: Plant) -> None:
    """The slave is set to another rate than the bus."""
    plant.ask(plant.made_up())
    plant.surrounded()
    others = [rate for rate in BAUD_RATES if rate != plant.baud and 19_200 <= rate <= 3_000_000]
    plant.real(baud=plant.rng.choice(others))


@plant_of(FAULTS, "wrong_address")
def other_address(plant: Plant) -> None:
    """The slave's address switches are set to another address, which the configuration does not have."""
    plant.ask_any()
    plant.surrounded()
    plant.real(plant.tables[0] | {"address": plant.free_address()})


@plant_of(FURTHER, rates=SLOW[1:])
def rate_mismatch(plant: Plant) -> None:
    """All slaves run at another rate than the configuration has; in half of the seeds another master does, too."""
    plant.ask(plant.made_up())
    true = plant.rng.choice([rate for rate in (45_450, 93_750, 187_500, 500_000) if rate != plant.baud])
    for _ in range(plant.rng.randint(2, 4)):
        table = plant.made_up()
        plant.tables.append(table)
        plant.there(table, baud=true)
    plant.real(baud=true)
    if plant.seed % 2:
        plant.other_master(baud=true)
        plant.run(50)


# --- another device, another rack ---------------------------------------------------------------------------------


@plant_of(FAULTS, "ident")
def sister_ident(plant: Plant) -> None:
    """A sister device of the same maker: alike in all but the ident number."""
    plant.ask_any()
    plant.surrounded()
    _sister(plant)


def _sister(plant: Plant, config: bytes | None = None) -> Unit:
    params = plant.slave.params
    ident = (params.ident or 0) ^ (1 << plant.rng.randrange(4))
    return plant.asked_unit(MirrorDevice(ident, config or params.config))


def _rack(plant: Plant, change: Callable[[list[str], Random, tuple[str, ...]], list[str]]) -> None:
    """Ask about a modular slave whose rack is ``change`` of the modules that the user configured."""
    known = IO_MODULES if plant.rng.random() < 0.6 else TERMINAL_MODULES
    make = plant.io_station if known is IO_MODULES else plant.terminal
    configured = plant.terminal_modules()[:3]
    if known is IO_MODULES:
        configured = [plant.rng.choice(known) for _ in range(plant.rng.randint(2, 6))]
    plant.ask(make(modules=configured))
    _plug(plant, lambda: change(list(configured), plant.rng, known))
    plant.surrounded(share=0.2)


def _plug(plant: Plant, rack: Callable[[], list[str]]) -> None:
    """The slave asked about has the modules of ``rack``, which is called until they are others than those configured,
    and fit into the device."""
    while True:
        with contextlib.suppress(ConfigError):
            there = slave_config(plant.tables[0] | {"modules": rack()}).params
            if there.config != plant.slave.params.config:
                plant.asked_unit(MirrorDevice(there.ident or 0, there.config))
                return


def _swapped(modules: list[str], rng: Random) -> list[str]:
    one, other = rng.sample(range(len(modules)), 2)
    modules[one], modules[other] = modules[other], modules[one]
    return modules


@plant_of(FAULTS)
def module_order(plant: Plant) -> None:
    """Two modules of the rack are in each other's slots."""
    known = IO_MODULES if plant.rng.random() < 0.6 else TERMINAL_MODULES
    make = plant.io_station if known is IO_MODULES else plant.terminal
    configured = plant.rng.sample(known, 2)  # two kinds at least
    more = plant.rng.randint(0, 4 if known is IO_MODULES else 1)
    configured += [plant.rng.choice([one for one in known if one != "4 AI"]) for _ in range(more)]
    plant.rng.shuffle(configured)
    plant.ask(make(modules=configured))
    _plug(plant, lambda: _swapped(list(configured), plant.rng))
    plant.surrounded(share=0.2)


@plant_of(FAULTS)
def module_missing(plant: Plant) -> None:
    """One module of the configuration is not in the rack; those behind it have moved up."""
    _rack(plant, lambda modules, rng, known: _without(modules, rng.randrange(len(modules))))


def _without(modules: list[str], number: int) -> list[str]:
    return modules[:number] + modules[number + 1 :]


@plant_of(FAULTS)
def module_extra(plant: Plant) -> None:
    """One module more is in the rack than in the configuration."""

    def change(modules: list[str], rng: Random, known: tuple[str, ...]) -> list[str]:
        modules.insert(rng.randint(0, len(modules)), rng.choice(known))
        return modules

    _rack(plant, change)


def _another_type(modules: list[str], rng: Random, known: tuple[str, ...]) -> list[str]:
    number = rng.randrange(len(modules))
    others = [one for one in known if one not in modules]
    modules[number] = rng.choice(others or [one for one in known if one != modules[number]])
    return modules


@plant_of(FAULTS)
def module_type(plant: Plant) -> None:
    """In one slot there is a module of another type."""
    if plant.rng.random() < 0.7:
        _rack(plant, _another_type)
        return
    # no GSD file: one identifier octet differs
    plant.ask(plant.made_up())
    config = bytearray(plant.slave.params.config)
    number = plant.rng.randrange(len(config))
    config[number] = plant.rng.choice([octet for octet in b"\x10\x11\x12\x20\x21\x22\x30\x51" if octet not in config])
    plant.asked_unit(MirrorDevice(plant.slave.params.ident or 0, bytes(config)))
    plant.neighbours()


# --- parameters -----------------------------------------------------------------------------------------------------


@plant_of(FAULTS)
def user_parameter(plant: Plant) -> None:
    """One octet of the user parameters is wrong, and the slave refuses it."""
    wrong_octet(plant)
    plant.surrounded()


def wrong_octet(plant: Plant, *, config: bytes | None = None) -> Picky:
    """Ask about a slave with one wrong octet in its user parameters; it has ``config`` if that is given."""
    rng = plant.rng
    kind = rng.choice(["made_up", "made_up", "io_station", "terminal"])
    if kind == "made_up":
        good = bytes([0, *rng.randbytes(rng.randint(2, 9))])
        table = plant.made_up()
        least = 0
    else:
        table = getattr(plant, kind)()
        good = slave_config(table).params.user_prm
        least = 3  # behind the octets of DPV1_Status
    if len(good) <= least:  # a rack without parameters
        return wrong_octet(plant, config=config)
    octets = bytearray(good)
    octets[rng.randrange(least, len(good))] ^= 1 << rng.randrange(5)
    plant.ask(table | {"user_prm": octets.hex(" ")})
    params = plant.slave.params
    device = Picky(params.ident or 0, config or params.config, good)
    plant.asked_unit(device)
    return device


@plant_of(FAULTS)
def user_parameter_length(plant: Plant) -> None:
    """The user parameters have the wrong length, and the slave refuses them: the user has forgotten them, or has others
    than those of the drive; or they are cut or too long, and nobody knows the right length (then a wrong octet looks
    the same, and is as good an answer)."""
    rng = plant.rng
    good = bytes([0, *rng.randbytes(rng.randint(2, 9))])
    match rng.choice(["forgotten", "forgotten", "drive", "unknown"]):
        case "forgotten":
            plant.ask(plant.made_up() | {"user_prm": ""})
        case "drive":
            plant.ask(plant.hoist())
            good = plant.slave.params.user_prm
            plant.tables[0]["user_prm"] = _other_length(rng, good).hex(" ")
        case _:
            plant.ask(plant.made_up() | {"user_prm": _other_length(rng, good).hex(" ")})
            plant.causes |= {"user_parameter"}
    params = plant.slave.params
    plant.asked_unit(Picky(params.ident or 0, params.config, good))
    plant.surrounded()


def _other_length(rng: Random, good: bytes) -> bytes:
    return good + rng.randbytes(rng.randint(1, 3)) if rng.random() < 0.5 or len(good) < 2 else good[:-1]


@plant_of(FURTHER)
def dpv1_mismatch(plant: Plant) -> None:
    """DP-V1 is switched on for a slave that has none, or off for one that needs it; the slave refuses that."""
    on = plant.rng.random() < 0.6
    if on:
        table = plant.made_up(user_prm="00 00 00")
        plant.ask(table | {"dpv1": True})
    else:
        table = plant.terminal()
        octets = bytearray(slave_config(table).params.user_prm)
        octets[0] &= 0x7F
        plant.ask(table | {"user_prm": octets.hex(" "), "dpv1": False})
    params = plant.slave.params
    plant.asked_unit((DpV0Only if on else NeedsDpV1)(params.ident or 0, params.config))
    plant.surrounded()


@plant_of(FAULTS)
def not_supported(plant: Plant) -> None:
    """The configuration asks for SYNC or FREEZE, which the slave does not have: Not_Supported."""
    plant.ask(plant.made_up())
    keys = plant.rng.choice([("sync",), ("freeze",), ("sync", "freeze")])
    plant.tables[0] |= dict.fromkeys(keys, True) | {"groups": [plant.rng.randint(1, 8)]}
    device = mirror_of(plant.slave)
    device.sync_supported = "sync" not in keys
    device.freeze_supported = "freeze" not in keys
    plant.asked_unit(device)
    plant.surrounded()


# --- owner, watchdog, address ---------------------------------------------------------------------------------------


@plant_of(FAULTS)
def locked(plant: Plant) -> None:
    """Another master has the slave: it is running, or has gone and left the slave locked without a watchdog."""
    plant.ask_any("made_up", "io_station")
    plant.neighbours()
    _lock(plant, gone=plant.rng.random() < 0.3)


def _lock(plant: Plant, *, gone: bool = False, device: MirrorDevice | None = None) -> None:
    if device is None:
        device = mirror_of(plant.slave)
    if gone:
        plant.asked_unit(locked_by(device, plant.free_master()))
        return
    plant.asked_unit(device)
    params = plant.slave.params
    theirs = type(params)(
        address=params.address,
        name="theirs",
        ident=device.ident,
        config=device.configs[0],
        user_prm=params.user_prm,
    )
    plant.other_master(theirs)
    plant.until_taken()


@plant_of(FAULTS, rates=(45450, 93750))
def watchdog_short(plant: Plant) -> None:
    """The watchdog of the slave is shorter than the time between two exchanges with it: this master has many slaves at
    a slow rate, or another master holds the token for long."""
    plant.ask_any("made_up", "io_station")
    if plant.rng.random() < 0.5:
        plant.neighbours(1, 2)
        big = [plant.made_up(config="3F 3F", user_prm="") for _ in range(8 if plant.baud > 50_000 else 4)]
        plant.tables += big
    else:
        plant.neighbours(0, 1)
        big = [plant.made_up(config="3F 3F", user_prm="") for _ in range(10 if plant.baud > 50_000 else 5)]
        plant.other_master(*(slave_config(table).params for table in big))
    for table in big:
        plant.there(table)
    plant.tables[0]["watchdog_ms"] = plant.rng.choice([10, 20, 30, 50])
    plant.real()
    plant.least_s = 4.0


@plant_of(FAULTS)
def duplicate_address(plant: Plant) -> None:
    """Two slaves have the address: of one type, or another device beside the right one."""
    plant.ask(plant.made_up())
    plant.neighbours()
    first, second = plant.rng.sample(range(11, 60), 2)
    plant.real(t_sdr=first)
    twin = mirror_of(plant.slave)
    if plant.rng.random() < 0.5:
        twin = MirrorDevice(twin.ident ^ 0x0101, twin.configs[0])
    plant.unit(twin, plant.at, t_sdr=second, label="twin")
    plant.stretch = 2


# --- the line -------------------------------------------------------------------------------------------------------


@plant_of(FAULTS, rates=SLOW)
def noise_on_stub(plant: Plant) -> None:
    """A bad contact at this slave: a share of its answers is damaged, a share of the requests does not reach it."""
    plant.ask_any()
    plant.surrounded(2, 4, share=0.2)
    plant.real()
    _stub(plant)


def _stub(plant: Plant, share: float | None = None) -> None:
    rng = plant.rng
    share = rng.uniform(0.25, 0.6) if share is None else share
    answers, requests = Share(rng, share, plant.at), Share(rng, share / 3, plant.at, to=True)
    plant.world.faults.damage(answers, times=None, flips=rng.choice([0x002, 0x006, 0x200]))
    plant.world.faults.drop(requests, times=None)
    plant.stretch = 2


@plant_of(FAULTS, rates=SLOW)
def noise_on_segment(plant: Plant) -> None:
    """Noise on the whole cable: every telegram may be damaged, whoever sends it."""
    plant.ask_any("made_up", "io_station")
    plant.surrounded(2, 4, share=0.2)
    plant.real()
    _noise(plant)


def _noise(plant: Plant, per_bit: float | None = None) -> None:
    plant.world.faults.noise(plant.rng.uniform(1e-3, 3e-3) if per_bit is None else per_bit)
    plant.stretch = 2


@plant_of(FAULTS, rates=SLOW[:2])
def bus_jammed(plant: Plant) -> None:
    """A defective station sends without end: from the beginning, or after a while of good traffic."""
    plant.ask_any("made_up", "io_station")
    plant.neighbours(1, 2)
    plant.real()
    plant.stretch = 0.7
    start = 0 if plant.rng.random() < 0.5 else round(plant.seconds / 2 * 1000) * MS
    plant.world.add(Babbler(plant.rng, start, plant.baud), name="babbler")


@plant_of(FAULTS, rates=SLOW)
def answers_late(plant: Plant) -> None:
    """Most answers of the slave begin after T_SL, by more or less: a slow application, or a radio link in front of it.
    Some are heard whole after the master has given up, some collide with its next telegram, some are in time. The user
    has made T_SL longer already, and not long enough."""
    plant.ask(plant.made_up())
    plant.neighbours(1, 3)
    plant.real(t_sdr=11)
    # as most plants have HSA: in the silence of GAP polls late answers are heard
    plant.bus_keys |= {"t_sl": plant.rng.randint(500, 800), "hsa": 126, "gap": 1}
    params = plant.open().params
    for number in range(2):  # an answer may get both delays
        by = params.ns(round(params.t_sl * plant.rng.uniform(0.7, 1.2) * (1 + number)))
        plant.world.faults.delay(Share(plant.rng, plant.rng.uniform(0.4, 0.6), plant.at), by, times=None)
    plant.stretch = 9


@plant_of(FURTHER, "min_tsdr")
def answers_too_soon(plant: Plant) -> None:
    """The slave answers before min T_SDR, when the master has not turned its transmitter round."""
    plant.ask(plant.made_up())
    plant.neighbours()
    plant.real(kind=Hasty)


# --- the device -----------------------------------------------------------------------------------------------------


@plant_of(FAULTS, rates=SLOW[1:3])
def reboots(plant: Plant) -> None:
    """The slave starts again and again: it runs for a while, is off for a while."""
    plant.ask_any("made_up", "io_station")
    plant.surrounded(share=0.2)
    _reboot(plant, plant.real(), plant.rng.randint(300, 500), plant.rng.randint(40, 120))
    plant.least_s = 2.0


def _reboot(plant: Plant, unit: Unit, on_ms: float, off_ms: float) -> None:
    def off() -> None:
        plant.unplug(unit)
        unit.app.restart(plant.world.now)
        plant.later(off_ms, on)

    def on() -> None:
        plant.plug(unit)
        plant.later(on_ms, off)

    plant.later(on_ms, off)


@plant_of(FAULTS, rates=SLOW[:3])
def not_ready(plant: Plant) -> None:
    """The slave's application is never ready: Station_Not_Ready stays after good parameters and configuration."""
    plant.ask_any()
    plant.surrounded()
    plant.asked_unit(NeverReady(mirror_of(plant.slave)))
    plant.stretch = 4


@plant_of(FAULTS, rates=SLOW[:3])
def static_diagnosis(plant: Plant) -> None:
    """The slave reports Stat_Diag, with or without a block that says why."""
    plant.ask_any()
    plant.surrounded()
    _ill(plant)


def _ill(plant: Plant) -> None:
    params = plant.slave.params
    device = Ill(params.ident or 0, params.config)
    device.ext = plant.rng.choice([b"", b"\x03\x81\x07", b"\x81\x00\xa6"])
    plant.asked_unit(device)
    plant.stretch = 3


@plant_of(FAULTS)
def data_length(plant: Plant) -> None:
    """Parameters and configuration are accepted, and the answers to Data_Exchange have another length."""
    plant.ask_any("made_up")
    while not io_lengths(plant.slave.params.config)[0]:
        plant.tables[0]["config"] = "20 10"
    plant.surrounded()
    more = [1, 2, -1] if io_lengths(plant.slave.params.config)[0] > 1 else [1, 2]
    plant.asked_unit(WrongLength(mirror_of(plant.slave), plant.rng.choice(more)))


@plant_of(FAULTS)
def service_refused(plant: Plant) -> None:
    """The slave answers one service with RS: Slave_Diag, Set_Prm, Chk_Cfg or Data_Exchange."""
    plant.ask_any()
    plant.surrounded()
    dsap = plant.rng.choice([SAP_SLAVE_DIAG, SAP_SET_PRM, SAP_CHK_CFG, None])
    plant.asked_unit(RefusesService(mirror_of(plant.slave), dsap))


@plant_of(FURTHER)
def deactivated(plant: Plant) -> None:
    """The application has taken the slave out of service."""
    plant.ask_any()
    plant.surrounded()
    plant.real()
    plant.orders.append(lambda bus: bus.slave(plant.name).deactivate())


# --- masters --------------------------------------------------------------------------------------------------------


@plant_of(FAULTS)
def no_token(plant: Plant) -> None:
    """Another master never lets this one into the ring: its HSA is below this address, or its GAP is off."""
    plant.ask_any("made_up", "io_station")
    plant.neighbours()
    plant.real()
    if plant.rng.random() < 0.6:
        lowest = plant.address = plant.rng.randint(5, HSA_LAST)
        plant.other_master(address=plant.rng.randrange(3), hsa=plant.rng.randint(3, lowest - 1))
    else:
        plant.other_master(gap=0)
    plant.run(200)


HSA_LAST: Final = 8


@plant_of(FAULTS)
def second_master_same_address(plant: Plant) -> None:
    """Another master has the address of this one: before it comes, or some time after it."""
    plant.ask_any("made_up", "io_station")
    plant.neighbours()
    plant.real()
    if plant.rng.random() < 0.5:
        plant.other_master(address=plant.address)
        plant.run(200)
    else:
        slaves = [unit.address for unit in plant.units]
        start = round(plant.seconds * 600) * MS
        rude = RudeMaster(plant.address, slaves, start, plant.rng.randint(2, 20) * MS, plant.baud)
        plant.world.add(rude, name="rude master")
        plant.stretch = 3


# --- healthy --------------------------------------------------------------------------------------------------------


@plant_of(HEALTHY, "healthy")
def healthy_alone(plant: Plant) -> None:
    """Everything as configured."""
    plant.ask_any()
    plant.neighbours(0, 4)
    plant.real()


@plant_of(HEALTHY, "healthy")
def healthy_beside_a_master(plant: Plant) -> None:
    """Everything as configured, beside another master with its own slave."""
    plant.ask_any()
    plant.neighbours()
    plant.real()
    plant.other_master()
    plant.run(50)


@plant_of(HEALTHY, "healthy")
def healthy_beside_a_fault(plant: Plant) -> None:
    """The slave is well; a neighbour has no power, and another one refuses its configuration."""
    plant.ask_any("made_up", "io_station")
    beside = plant.neighbours(2, 4)
    plant.unplug(beside[0])
    table = plant.made_up(config="20 10")
    plant.tables.append(table)
    plant.unit(MirrorDevice(table["ident"], b"\x21\x10"), table["address"])
    plant.real()


@plant_of(HEALTHY, "healthy", rates=SLOW[1:3])
def healthy_drive(plant: Plant) -> None:
    """A drive that runs."""
    plant.ask(plant.hoist())
    plant.driven = plant.name
    plant.neighbours()
    plant.real()
    plant.least_s = 2.0


@plant_of(HEALTHY, "healthy", rates=SLOW[:3])
def healthy_after_a_restart(plant: Plant) -> None:
    """The slave was switched on late, and has run well since."""
    plant.ask_any()
    plant.neighbours()
    unit = plant.real(on=False)
    plant.later(plant.rng.randint(100, 400), lambda: plant.plug(unit))
    plant.least_s = 4.0


# --- two faults at once ---------------------------------------------------------------------------------------------


@plant_of(PAIRS, "noise_on_segment", "module_type", rates=SLOW)
def noise_and_module(plant: Plant) -> None:
    """Noise on the whole cable, and a wrong module in the rack."""
    _rack(plant, _another_type)
    _noise(plant, plant.rng.uniform(0.6e-3, 1.2e-3))
    plant.stretch = 4


@plant_of(PAIRS, "noise_on_stub", "user_parameter", rates=SLOW[:2])
def stub_and_parameter(plant: Plant) -> None:
    """A bad contact at the slave, and a wrong octet in its user parameters."""
    wrong_octet(plant)
    plant.neighbours(2, 4)
    _stub(plant, plant.rng.uniform(0.25, 0.4))
    plant.least_s = 8.0


@plant_of(PAIRS, "user_parameter", "module_type")
def parameter_and_module(plant: Plant) -> None:
    """A wrong octet in the user parameters, and a wrong module, of which Get_Cfg knows."""
    device = wrong_octet(plant)
    config = bytearray(plant.slave.params.config)
    config[-1] = plant.rng.choice([octet for octet in b"\x10\x11\x20\x21\x30" if octet not in config])
    device.configs = (bytes(config),)
    plant.neighbours()


@plant_of(PAIRS, "locked", "ident")
def locked_sister(plant: Plant) -> None:
    """A sister device stands at the address, and another master has it."""
    plant.ask(plant.made_up())
    plant.neighbours()
    params = plant.slave.params
    _lock(plant, device=MirrorDevice((params.ident or 0) ^ 0x0004, params.config))


@plant_of(PAIRS, "ident", "module_type")
def sister_with_another_rack(plant: Plant) -> None:
    """A sister device stands at the address, and its rack is another one."""
    table: Table = plant.io_station()
    plant.ask(table)
    real = slave_config(table | {"modules": _another_type(list(table["modules"]), plant.rng, IO_MODULES)})
    _sister(plant, real.params.config)
    plant.neighbours()


ALL: Final = FAULTS | FURTHER | HEALTHY | PAIRS
#: the seeds of each
SEEDS: Final = range(20)
