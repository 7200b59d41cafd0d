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
from collections.abc import Callable
from random import Random
from typing import Final

from faults.devices import Babbler, DpV0Only, Hasty, Ill, NeedsDpV1, Picky, RefusesService, RudeMaster, Share
from faults.slaves import NeverReady, WrongLength, locked_by

from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave_side.virtual_bench import device_of
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import SAP_CHK_CFG, SAP_SET_PRM, SAP_SLAVE_DIAG
from dpstack.gsd.identifiers import io_lengths
from dpstack.units import BAUD_RATES
from tests.why.fault_plants import IO_MODULES, MS, TERMINAL_MODULES, Plant, Table, Unit

MakePlant = Callable[[int], Plant]
#: rates for plants that need longer
SLOW: Final = (45_450, 93_750, 187_500, 500_000)


def mirror_of(slave: SlaveConfig, **more: object) -> MirrorDevice:
    """A slave that accepts the configuration of ``slave``, and any user parameters."""
    return MirrorDevice(slave.params.ident or 0, slave.params.config, slave.name)


# --- nobody answers at the address --------------------------------------------------------------------------------


def no_power(seed: int) -> Plant:
    """The slave has no power; its neighbours run."""
    plant = Plant("no_power", seed, ["not_there"])
    plant.ask_any()
    plant.neighbours()
    plant.maybe_other_master()
    return plant


def wires_open(seed: int) -> Plant:
    """The cable is torn: this slave and one or two behind it are cut off, those before it run."""
    plant = Plant("wires_open", seed, ["not_there"])
    plant.ask_any()
    beside = plant.neighbours(2, 5)
    for unit in beside[1 : 1 + plant.rng.randint(1, 2)]:
        plant.unplug(unit)
    return plant


def deaf_at_rate(seed: int) -> Plant:
    """The slave is set to another rate than the bus."""
    plant = Plant("deaf_at_rate", seed, ["not_there"])
    plant.ask(plant.made_up())
    plant.neighbours()
    plant.maybe_other_master()
    others = [rate for rate in BAUD_RATES if rate != plant.baud and 19_200 <= rate <= 3_000_000]
    plant.real(baud=plant.rng.choice(others))
    return plant


def other_address(seed: int) -> Plant:
    """The slave's address switches are set to another address, which the configuration does not have."""
    plant = Plant("other_address", seed, ["wrong_address"])
    plant.ask_any()
    plant.neighbours()
    plant.maybe_other_master()
    plant.real(plant.tables[0] | {"address": plant.free_address()})
    return plant


def rate_mismatch(seed: int) -> Plant:
    """All slaves run at another rate than the configuration has; in half of the seeds another master does, too."""
    plant = Plant("rate_mismatch", seed, ["rate_mismatch"], rates=SLOW[1:])
    plant.ask(plant.made_up())
    true = plant.rng.choice([rate for rate in (45_450, 93_750, 187_500, 500_000) if rate != plant.baud])
    for _ in range(plant.rng.randint(2, 4)):
        table = plant.made_up()
        plant.tables.append(table)
        plant.unit(device_of(plant.config_of(table)), table["address"], baud=true)
    plant.real(baud=true)
    if seed % 2:
        plant.other_master(baud=true)
        plant.run(50)
    return plant


# --- another device, another rack ---------------------------------------------------------------------------------


def sister_ident(seed: int) -> Plant:
    """A sister device of the same maker: alike in all but the ident number."""
    plant = Plant("sister_ident", seed, ["ident"])
    plant.ask_any()
    plant.neighbours()
    plant.maybe_other_master()
    _sister(plant)
    return plant


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
    plant.neighbours()
    plant.maybe_other_master(0.2)


def _plug(plant: Plant, rack: Callable[[], list[str]]) -> None:
    """The slave asked about has the modules of ``rack``, which is called until they are others than those configured,
    and fit into the device."""
    while True:
        with contextlib.suppress(ConfigError):
            there = plant.config_of(plant.tables[0] | {"modules": rack()}).params
            if there.config != plant.slave.params.config:
                plant.asked_unit(MirrorDevice(there.ident or 0, there.config))
                return


def _swapped(modules: list[str], rng: Random) -> list[str]:
    one, other = rng.sample(range(len(modules)), 2)
    modules[one], modules[other] = modules[other], modules[one]
    return modules


def module_order(seed: int) -> Plant:
    """Two modules of the rack are in each other's slots."""
    plant = Plant("module_order", seed, ["module_order"])
    known = IO_MODULES if plant.rng.random() < 0.6 else TERMINAL_MODULES
    make = plant.io_station if known is IO_MODULES else plant.terminal
    configured = plant.rng.sample(known, 2)  # two kinds at least
    more = plant.rng.randint(0, 4 if known is IO_MODULES else 1)
    configured += [plant.rng.choice([one for one in known if one != "4 AI"]) for _ in range(more)]
    plant.rng.shuffle(configured)
    plant.ask(make(modules=configured))
    _plug(plant, lambda: _swapped(list(configured), plant.rng))
    plant.neighbours()
    plant.maybe_other_master(0.2)
    return plant


def module_missing(seed: int) -> Plant:
    """One module of the configuration is not in the rack; those behind it have moved up."""
    plant = Plant("module_missing", seed, ["module_missing"])
    _rack(plant, lambda modules, rng, known: _without(modules, rng.randrange(len(modules))))
    return plant


def _without(modules: list[str], number: int) -> list[str]:
    return modules[:number] + modules[number + 1 :]


def module_extra(seed: int) -> Plant:
    """One module more is in the rack than in the configuration."""
    plant = Plant("module_extra", seed, ["module_extra"])

    def change(modules: list[str], rng: Random, known: tuple[str, ...]) -> list[str]:
        modules.insert(rng.randint(0, len(modules)), rng.choice(known))
        return modules

    _rack(plant, change)
    return plant


def _another_type(modules: list[str], rng: Random, known: tuple[str, ...]) -> list[str]:
    number = rng.randrange(len(modules))
    others = [one for one in known if one not in modules]
    modules[number] = rng.choice(others or [one for one in known if one != modules[number]])
    return modules


def module_type(seed: int) -> Plant:
    """In one slot there is a module of another type."""
    plant = Plant("module_type", seed, ["module_type"])
    if plant.rng.random() < 0.7:
        _rack(plant, _another_type)
        return plant
    # no GSD file: one identifier octet differs
    plant.ask(plant.made_up())
    config = bytearray(plant.slave.params.config)
    number = plant.rng.randrange(len(config))
    config[number] = plant.rng.choice([octet for octet in b"\x10\x11\x12\x20\x21\x22\x30\x51" if octet not in config])
    plant.asked_unit(MirrorDevice(plant.slave.params.ident or 0, bytes(config)))
    plant.neighbours()
    return plant


# --- parameters -----------------------------------------------------------------------------------------------------


def user_parameter(seed: int) -> Plant:
    """One octet of the user parameters is wrong, and the slave refuses it."""
    plant = Plant("user_parameter", seed, ["user_parameter"])
    wrong_octet(plant)
    plant.neighbours()
    plant.maybe_other_master()
    return plant


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
        good = plant.config_of(table).params.user_prm
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


def user_parameter_length(seed: int) -> Plant:
    """The user parameters have the wrong length, and the slave refuses them: the user has forgotten them, or has others
    than those of the drive; or they are cut or too long, and nobody knows the right length (then a wrong octet looks
    the same, and is as good an answer)."""
    plant = Plant("user_parameter_length", seed, ["user_parameter_length"])
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
    plant.neighbours()
    plant.maybe_other_master()
    return plant


def _other_length(rng: Random, good: bytes) -> bytes:
    return good + rng.randbytes(rng.randint(1, 3)) if rng.random() < 0.5 or len(good) < 2 else good[:-1]


def dpv1_mismatch(seed: int) -> Plant:
    """DP-V1 is switched on for a slave that has none, or off for one that needs it; the slave refuses that."""
    plant = Plant("dpv1_mismatch", seed, ["dpv1_mismatch"])
    on = plant.rng.random() < 0.6
    if on:
        table = plant.made_up(user_prm="00 00 00")
        plant.ask(table | {"dpv1": True})
    else:
        table = plant.terminal()
        octets = bytearray(plant.config_of(table).params.user_prm)
        octets[0] &= 0x7F
        plant.ask(table | {"user_prm": octets.hex(" "), "dpv1": False})
    params = plant.slave.params
    plant.asked_unit((DpV0Only if on else NeedsDpV1)(params.ident or 0, params.config))
    plant.neighbours()
    plant.maybe_other_master()
    return plant


def not_supported(seed: int) -> Plant:
    """The configuration asks for SYNC or FREEZE, which the slave does not have: Not_Supported."""
    plant = Plant("not_supported", seed, ["not_supported"])
    plant.ask(plant.made_up())
    keys = plant.rng.choice([("sync",), ("freeze",), ("sync", "freeze")])
    plant.tables[0] |= dict.fromkeys(keys, True) | {"groups": [plant.rng.randint(1, 8)]}
    device = mirror_of(plant.slave)
    device.sync_supported = "sync" not in keys
    device.freeze_supported = "freeze" not in keys
    plant.asked_unit(device)
    plant.neighbours()
    plant.maybe_other_master()
    return plant


# --- owner, watchdog, address ---------------------------------------------------------------------------------------


def locked(seed: int) -> Plant:
    """Another master has the slave: it is running, or has gone and left the slave locked without a watchdog."""
    plant = Plant("locked", seed, ["locked"])
    plant.ask_any("made_up", "io_station")
    plant.neighbours()
    _lock(plant, gone=plant.rng.random() < 0.3)
    return plant


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
    other = plant.other_master(theirs)
    for _ in range(200):
        plant.run(10)
        if other.exchanges_with(params.address):
            return
    raise AssertionError("the other master does not get the slave")


def watchdog_short(seed: int) -> Plant:
    """The watchdog of the slave is shorter than the time between two exchanges with it: this master has many slaves at
    a slow rate, or another master holds the token for long."""
    plant = Plant("watchdog_short", seed, ["watchdog_short"], rates=(45_450, 93_750))
    plant.ask_any("made_up", "io_station")
    if plant.rng.random() < 0.5:
        plant.neighbours(1, 2)
        big = [plant.made_up(config="3F 3F", user_prm="") for _ in range(8 if plant.baud > 50_000 else 4)]
        plant.tables += big
    else:
        plant.neighbours(0, 1)
        big = [plant.made_up(config="3F 3F", user_prm="") for _ in range(10 if plant.baud > 50_000 else 5)]
        plant.other_master(*(plant.config_of(table).params for table in big))
    for table in big:
        plant.unit(device_of(plant.config_of(table)), table["address"])
    plant.tables[0]["watchdog_ms"] = plant.rng.choice([10, 20, 30, 50])
    plant.real()
    plant.least_s = 4.0
    return plant


def duplicate_address(seed: int) -> Plant:
    """Two slaves have the address: of one type, or another device beside the right one."""
    plant = Plant("duplicate_address", seed, ["duplicate_address"])
    plant.ask(plant.made_up())
    plant.neighbours()
    first, second = plant.rng.sample(range(11, 60), 2)
    plant.real(t_sdr=first)
    twin = mirror_of(plant.slave)
    if plant.rng.random() < 0.5:
        twin = MirrorDevice(twin.ident ^ 0x0101, twin.configs[0])
    plant.unit(twin, plant.at, t_sdr=second, label="twin")
    plant.stretch = 2
    return plant


# --- the line -------------------------------------------------------------------------------------------------------


def noise_on_stub(seed: int) -> Plant:
    """A bad contact at this slave: a share of its answers is damaged, a share of the requests does not reach it."""
    plant = Plant("noise_on_stub", seed, ["noise_on_stub"], rates=SLOW)
    plant.ask_any()
    plant.neighbours(2, 4)
    plant.maybe_other_master(0.2)
    plant.real()
    _stub(plant)
    return plant


def _stub(plant: Plant, share: float | None = None) -> None:
    rng = plant.rng
    share = rng.uniform(0.25, 0.6) if share is None else share
    answers, requests = Share(rng, share, plant.at), Share(rng, share / 3, plant.at, to=True)
    plant.world.faults.damage(answers, times=None, flips=rng.choice([0x002, 0x006, 0x200]))
    plant.world.faults.drop(requests, times=None)
    plant.stretch = 2


def noise_on_segment(seed: int) -> Plant:
    """Noise on the whole cable: every telegram may be damaged, whoever sends it."""
    plant = Plant("noise_on_segment", seed, ["noise_on_segment"], rates=SLOW)
    plant.ask_any("made_up", "io_station")
    plant.neighbours(2, 4)
    plant.maybe_other_master(0.2)
    plant.real()
    _noise(plant)
    return plant


def _noise(plant: Plant, per_bit: float | None = None) -> None:
    plant.world.faults.noise(plant.rng.uniform(1e-3, 3e-3) if per_bit is None else per_bit)
    plant.stretch = 2


def bus_jammed(seed: int) -> Plant:
    """A defective station sends without end: from the beginning, or after a while of good traffic."""
    plant = Plant("bus_jammed", seed, ["bus_jammed"], rates=SLOW[:2])
    plant.ask_any("made_up", "io_station")
    plant.neighbours(1, 2)
    plant.real()
    plant.stretch = 0.7
    start = 0 if plant.rng.random() < 0.5 else round(plant.seconds / 2 * 1000) * MS
    plant.world.add(Babbler(plant.rng, start, plant.baud), name="babbler")
    return plant


def answers_late(seed: int) -> Plant:
    """Most answers of the slave begin after T_SL, by more or less: a slow application, or a radio link in front of it.
    Some are heard whole after the master has given up, some collide with its next telegram, some are in time. The user
    has made T_SL longer already, and not long enough."""
    plant = Plant("answers_late", seed, ["answers_late"], rates=SLOW)
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
    return plant


def answers_too_soon(seed: int) -> Plant:
    """The slave answers before min T_SDR, when the master has not turned its transmitter round."""
    plant = Plant("answers_too_soon", seed, ["min_tsdr"])
    plant.ask(plant.made_up())
    plant.neighbours()
    plant.real(kind=Hasty)
    return plant


# --- the device -----------------------------------------------------------------------------------------------------


def reboots(seed: int) -> Plant:
    """The slave starts again and again: it runs for a while, is off for a while."""
    plant = Plant("reboots", seed, ["reboots"], rates=SLOW[1:3])
    plant.ask_any("made_up", "io_station")
    plant.neighbours()
    plant.maybe_other_master(0.2)
    _reboot(plant, plant.real(), plant.rng.randint(300, 500), plant.rng.randint(40, 120))
    plant.least_s = 2.0
    return plant


def _reboot(plant: Plant, unit: Unit, on_ms: float, off_ms: float) -> None:
    def off() -> None:
        plant.unplug(unit)
        unit.app.restart(plant.world.now)
        plant.later(off_ms, on)

    def on() -> None:
        plant.plug(unit)
        plant.later(on_ms, off)

    plant.later(on_ms, off)


def not_ready(seed: int) -> Plant:
    """The slave's application is never ready: Station_Not_Ready stays after good parameters and configuration."""
    plant = Plant("not_ready", seed, ["not_ready"], rates=SLOW[:3])
    plant.ask_any()
    plant.neighbours()
    plant.maybe_other_master()
    plant.asked_unit(NeverReady(mirror_of(plant.slave)))
    plant.stretch = 4
    return plant


def static_diagnosis(seed: int) -> Plant:
    """The slave reports Stat_Diag, with or without a block that says why."""
    plant = Plant("static_diagnosis", seed, ["static_diagnosis"], rates=SLOW[:3])
    plant.ask_any()
    plant.neighbours()
    plant.maybe_other_master()
    _ill(plant)
    return plant


def _ill(plant: Plant) -> None:
    params = plant.slave.params
    device = Ill(params.ident or 0, params.config)
    device.ext = plant.rng.choice([b"", b"\x03\x81\x07", b"\x81\x00\xa6"])
    plant.asked_unit(device)
    plant.stretch = 3


def data_length(seed: int) -> Plant:
    """Parameters and configuration are accepted, and the answers to Data_Exchange have another length."""
    plant = Plant("data_length", seed, ["data_length"])
    plant.ask_any("made_up")
    while not io_lengths(plant.slave.params.config)[0]:
        plant.tables[0]["config"] = "20 10"
    plant.neighbours()
    plant.maybe_other_master()
    more = [1, 2, -1] if io_lengths(plant.slave.params.config)[0] > 1 else [1, 2]
    plant.asked_unit(WrongLength(mirror_of(plant.slave), plant.rng.choice(more)))
    return plant


def service_refused(seed: int) -> Plant:
    """The slave answers one service with RS: Slave_Diag, Set_Prm, Chk_Cfg or Data_Exchange."""
    plant = Plant("service_refused", seed, ["service_refused"])
    plant.ask_any()
    plant.neighbours()
    plant.maybe_other_master()
    dsap = plant.rng.choice([SAP_SLAVE_DIAG, SAP_SET_PRM, SAP_CHK_CFG, None])
    plant.asked_unit(RefusesService(mirror_of(plant.slave), dsap))
    return plant


def deactivated(seed: int) -> Plant:
    """The application has taken the slave out of service."""
    plant = Plant("deactivated", seed, ["deactivated"])
    plant.ask_any()
    plant.neighbours()
    plant.maybe_other_master()
    plant.real()
    plant.orders.append(lambda bus: bus.slave(plant.name).deactivate())
    return plant


# --- masters --------------------------------------------------------------------------------------------------------


def no_token(seed: int) -> Plant:
    """Another master never lets this one into the ring: its HSA is below this address, or its GAP is off."""
    plant = Plant("no_token", seed, ["no_token"])
    plant.ask_any("made_up", "io_station")
    plant.neighbours()
    plant.real()
    if plant.rng.random() < 0.6:
        lowest = plant.address = plant.rng.randint(5, HSA_LAST)
        plant.other_master(address=plant.rng.randrange(3), hsa=plant.rng.randint(3, lowest - 1))
    else:
        plant.other_master(gap=0)
    plant.run(200)
    return plant


HSA_LAST: Final = 8


def second_master_same_address(seed: int) -> Plant:
    """Another master has the address of this one: before it comes, or some time after it."""
    plant = Plant("second_master_same_address", seed, ["second_master_same_address"])
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
    return plant


# --- healthy --------------------------------------------------------------------------------------------------------


def healthy_alone(seed: int) -> Plant:
    """Everything as configured."""
    plant = Plant("healthy_alone", seed, ["healthy"])
    plant.ask_any()
    plant.neighbours(0, 4)
    plant.real()
    return plant


def healthy_beside_a_master(seed: int) -> Plant:
    """Everything as configured, beside another master with its own slave."""
    plant = Plant("healthy_beside_a_master", seed, ["healthy"])
    plant.ask_any()
    plant.neighbours()
    plant.real()
    plant.other_master()
    plant.run(50)
    return plant


def healthy_beside_a_fault(seed: int) -> Plant:
    """The slave is well; a neighbour has no power, and another one refuses its configuration."""
    plant = Plant("healthy_beside_a_fault", seed, ["healthy"])
    plant.ask_any("made_up", "io_station")
    beside = plant.neighbours(2, 4)
    plant.unplug(beside[0])
    table = plant.made_up(config="20 10")
    plant.tables.append(table)
    plant.unit(MirrorDevice(table["ident"], b"\x21\x10"), table["address"])
    plant.real()
    return plant


def healthy_drive(seed: int) -> Plant:
    """A drive that runs."""
    plant = Plant("healthy_drive", seed, ["healthy"], rates=SLOW[1:3])
    plant.ask(plant.hoist())
    plant.driven = plant.name
    plant.neighbours()
    plant.real()
    plant.least_s = 1.5
    return plant


def healthy_after_a_restart(seed: int) -> Plant:
    """The slave was switched on late, and has run well since."""
    plant = Plant("healthy_after_a_restart", seed, ["healthy"], rates=SLOW[:3])
    plant.ask_any()
    plant.neighbours()
    unit = plant.real(on=False)
    plant.later(plant.rng.randint(100, 400), lambda: plant.plug(unit))
    plant.least_s = 4.0
    return plant


# --- two faults at once ---------------------------------------------------------------------------------------------


def noise_and_module(seed: int) -> Plant:
    """Noise on the whole cable, and a wrong module in the rack."""
    plant = Plant("noise_and_module", seed, ["noise_on_segment", "module_type"], every=True, rates=SLOW)
    _rack(plant, _another_type)
    _noise(plant, plant.rng.uniform(0.6e-3, 1.2e-3))
    plant.stretch = 4
    return plant


def stub_and_parameter(seed: int) -> Plant:
    """A bad contact at the slave, and a wrong octet in its user parameters."""
    plant = Plant("stub_and_parameter", seed, ["noise_on_stub", "user_parameter"], every=True, rates=SLOW[:2])
    wrong_octet(plant)
    plant.neighbours(2, 4)
    _stub(plant, plant.rng.uniform(0.25, 0.4))
    plant.least_s = 8.0
    return plant


def parameter_and_module(seed: int) -> Plant:
    """A wrong octet in the user parameters, and a wrong module, of which Get_Cfg knows."""
    plant = Plant("parameter_and_module", seed, ["user_parameter", "module_type"], every=True)
    device = wrong_octet(plant)
    config = bytearray(plant.slave.params.config)
    config[-1] = plant.rng.choice([octet for octet in b"\x10\x11\x20\x21\x30" if octet not in config])
    device.configs = (bytes(config),)
    plant.neighbours()
    return plant


def locked_sister(seed: int) -> Plant:
    """A sister device stands at the address, and another master has it."""
    plant = Plant("locked_sister", seed, ["locked", "ident"], every=True)
    plant.ask(plant.made_up())
    plant.neighbours()
    params = plant.slave.params
    _lock(plant, device=MirrorDevice((params.ident or 0) ^ 0x0004, params.config))
    return plant


def sister_with_another_rack(seed: int) -> Plant:
    """A sister device stands at the address, and its rack is another one."""
    plant = Plant("sister_with_another_rack", seed, ["ident", "module_type"], every=True)
    table: Table = plant.io_station()
    plant.ask(table)
    real = plant.config_of(table | {"modules": _another_type(list(table["modules"]), plant.rng, IO_MODULES)})
    _sister(plant, real.params.config)
    plant.neighbours()
    return plant


def _table(*makers: MakePlant) -> dict[str, MakePlant]:
    return {make.__name__: make for make in makers}


FAULTS: Final = _table(
    no_power,
    deaf_at_rate,
    other_address,
    sister_ident,
    module_order,
    module_missing,
    module_extra,
    module_type,
    user_parameter,
    user_parameter_length,
    not_supported,
    locked,
    watchdog_short,
    duplicate_address,
    noise_on_stub,
    noise_on_segment,
    bus_jammed,
    answers_late,
    reboots,
    not_ready,
    static_diagnosis,
    data_length,
    service_refused,
    no_token,
    second_master_same_address,
)
FURTHER: Final = _table(wires_open, rate_mismatch, dpv1_mismatch, answers_too_soon, deactivated)
HEALTHY: Final = _table(
    healthy_alone, healthy_beside_a_master, healthy_beside_a_fault, healthy_drive, healthy_after_a_restart
)
PAIRS: Final = _table(
    noise_and_module, stub_and_parameter, parameter_and_module, locked_sister, sister_with_another_rack
)
ALL: Final = FAULTS | FURTHER | HEALTHY | PAIRS
#: the seeds of each
SEEDS: Final = range(20)
