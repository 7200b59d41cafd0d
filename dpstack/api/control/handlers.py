"""The control server of a run, and the handlers of its commands.

Modules that only one command needs are loaded when it comes, beside the bus.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, Final

from msgspec import structs, to_builtins

from dpstack.api.bus.bus import Bus, core_of
from dpstack.api.bus.parts import SEARCHING
from dpstack.api.bus.picture import drive_dict, picture_of, picture_of_cpu
from dpstack.api.bus.statistics import clear_since
from dpstack.api.control import arguments
from dpstack.api.control.arguments import PTY, address_of
from dpstack.api.control.commands import KINDS, NOW, SLAVES, UNASKED
from dpstack.api.control.control_server import ControlServer, Handler, LongCommand, Send, kept_alive
from dpstack.api.control.orders import carry_out, octets_of, put_out
from dpstack.api.control.tap_feed import TapFeed
from dpstack.api.slave.slave import Slave
from dpstack.api.streams import load_beside
from dpstack.dp.master.scanner import Found
from dpstack.errors import BusError, UsageError
from dpstack.fdl.livelist import ALL_ADDRESSES
from dpstack.params import UNADDRESSED
from dpstack.plant.orders import Argument, ModeOrder, RefusedOrder, SetCpuValues, SetOctets, SetOutputs
from dpstack.plant.value_quality import qualities_of
from dpstack.text import number_or_name

if TYPE_CHECKING:
    from dpstack.api.bus.core import BusCore
    from dpstack.api.config.cpu import CpuConfig
    from dpstack.api.control.round_traces import RoundTraces
    from dpstack.api.ppi.cpu import Cpu
    from dpstack.api.ppi.polling import CpuPolling
    from dpstack.plant.items import SlaveValues

#: addresses that a scan asks in one go; its progress counts them
_SCAN_PART: Final = 16
_KNOWN: Final = "dpstack.api.control.known_stations"


def control_run(
    bus: Bus,
    port: str,
    feed: TapFeed | None = None,
    *,
    stop: Callable[[], None] | None = None,
    kind: str = "run",
) -> ControlServer:
    """The control server of a master on ``port``; of one with a pty :meth:`ControlServer.move_to` its path. ``feed``:
    of its tap, if there is one already; ``stop`` ends the program in order; ``kind``: of the program."""

    def end(_args: list[str]) -> None:
        if stop is None:
            raise UsageError("this program ends by itself, and not by a command")
        stop()

    specs = KINDS["run"]
    handlers: dict[str, Handler] = {
        "status": lambda _: run_status(bus),
        "outputs": lambda args: _outputs(bus, args),
        "set": lambda args: set_values(bus, args),
        "operate": lambda _: carry_out(bus, ModeOrder("operate")),
        "clear": lambda _: carry_out(bus, ModeOrder("clear")),
        "stop": end,
        "drive": _by_need("drive_orders", "drive_order", bus),
        "order": _by_need("drive_orders", "device_order", bus),
        "acyclic": _by_need("record_orders", "acyclic_order", bus),
        "class2": _by_need("record_orders", "acyclic_order", bus, class2=True),
        "diag": lambda args: _diag(bus, args[0], ask=_is_asking(args[1:])),
        "fdl": lambda args: _fdl(bus, args),
        "ppi": _ppi(bus),
        "stats": lambda _: bus.stats.summary(),
        "scan": ScanOrder(bus),
        "rounds": _rounds(bus),
        "why": lambda args: _why(bus, args),
        "refused": lambda args: core_of(bus).refused_orders.add(RefusedOrder(args[1], args[2], args[0])),
        "tap": (feed or run_feed(bus)).handler,
        "live": _by_need("live_items", "live_items", bus),
    }
    core = core_of(bus)
    if not bus.searching and core.bench is not None:
        from dpstack.api.control.simulation_handlers import slave_handlers  # here, as a real bus simulates no slaves

        specs = (*specs, *(spec for spec in SLAVES if spec.name not in handlers))
        handlers = slave_handlers(core.bench, core) | handlers
    # there may be several runs with a pty
    own, also = (f"{PTY}:{os.getpid()}", PTY) if port == PTY else (port, None)

    def refused(order: RefusedOrder) -> None:
        core.refused_orders.add(order)

    return ControlServer(kind, own, specs, handlers, also=also, config=bus.config.file, refused=refused)


def _by_need(module: str, name: str, bus: Bus, **options: bool) -> Handler:
    """The handler ``name`` of ``module`` in this room."""
    place = f"{__package__}.{module}"

    async def carry_out(args: list[str]) -> object:
        await load_beside(place)
        result: object = getattr(sys.modules[place], name)(bus, args, **options)
        return result

    return carry_out


def _fdl(bus: Bus, args: list[str]) -> LongCommand:
    """An FDL service of this station beside its DP master, which refuses what is not for it."""
    if bus.searching:
        raise BusError(f"{SEARCHING}: no station can be asked before")

    async def work() -> dict[str, object]:
        await load_beside("dpstack.api.fdl.orders")
        from dpstack.api.fdl import orders as fdl_orders

        return await fdl_orders.carry_out(bus.fdl, fdl_orders.parse_fdl_order(args))

    return lambda send: kept_alive(work(), lambda: {"state": "asking"}, send)


def _ppi(bus: Bus) -> Handler:
    """The handler of orders to S7-200 CPUs beside the DP master; orders to one CPU wait for each other."""
    others: dict[int, Cpu] = {}  # that are not of the plant file

    def carry_out(args: list[str]) -> LongCommand:
        if bus.searching:
            raise BusError(f"{SEARCHING}: no station can be asked before")

        async def work() -> dict[str, object]:
            await load_beside("dpstack.api.ppi.orders")
            from dpstack.api.ppi.orders import carry_out_beside

            return {"lines": await carry_out_beside(core_of(bus), args, others)}

        return lambda send: kept_alive(work(), lambda: {"state": "asking"}, send)

    return carry_out


def _rounds(bus: Bus) -> Handler:
    """The handler of the values of each round: its rings stay between two requests."""
    found: list[RoundTraces] = []

    async def carry_out(args: list[str]) -> object:
        await load_beside("dpstack.api.control.round_traces")
        from dpstack.api.control.round_traces import RoundTraces

        if bus.searching:
            raise BusError(f"{SEARCHING}: there are no rounds before")
        if not found:
            found.append(RoundTraces(core_of(bus)))
        return found[0].read(args)

    return carry_out


def run_feed(bus: Bus) -> TapFeed:
    """The feed of the tap of a master; a line has one tap at a time."""

    def about() -> dict[str, object]:
        if bus.searching:
            return {"baud": None, "paced": True}
        core = core_of(bus)
        return {"baud": core.params.baud, "paced": core.runtime.paced, "exact": core.world is not None}

    # nothing of these is there while the bus searches for its rate
    return TapFeed(lambda tap: core_of(bus).runtime.tap(tap), lambda: core_of(bus).runtime.now(), about)


#: keys of a slave's status: those that are always there, and those that are left out without a content
_ALWAYS: Final = ("state", "inputs_valid", "inputs_age_ms", "inputs", "outputs")
_IF_THERE: Final = ("held", "fields", "held_fields", "withheld")


def run_status(bus: Bus) -> dict[str, object]:
    """State of the master: ``seconds``, ``mode``, ``baud``, ``in_ring``, ``masters``, ``slaves``; ``clear``
    (:func:`~dpstack.api.bus.statistics.clear_since`) after it went to Clear by itself.

    While it searches its baud rate: only ``baud`` None and a ``text``.
    """
    if bus.searching:
        return {"baud": None, "text": SEARCHING}
    slaves: dict[str, object] = {}
    core = core_of(bus)
    for slave in bus.slaves:
        values = picture_of(core, slave)
        entry = _station_status(slave.name, values, _ALWAYS)
        if values.diagnosis is not None:
            entry["diagnosis"] = to_builtins(values.diagnosis)
        if values.alarms is not None:
            entry["alarms"] = values.alarms
        if values.drive is not None:
            entry["drive"] = drive_dict(values.drive)
        if values.drives is not None:
            entry["drives"] = {name: drive_dict(one) for name, one in values.drives.items()}
        if core.bench is not None:
            entry |= core.bench.status_of(slave.address)
        slaves[str(slave.address)] = entry
    for address, polling in core.cpus.items():
        slaves[str(address)] = _cpu_status(core, polling)
    return {
        "seconds": round(bus.seconds, 3),
        "address": bus.params.address,
        "mode": bus.mode.name.lower(),
        **({"clear": clear} if (clear := clear_since(core)) else {}),
        "baud": bus.params.baud,
        "in_ring": bus.snapshot.in_ring,
        "masters": sorted(bus.snapshot.las),
        "slaves": slaves,
    }


def _station_status(name: str, values: SlaveValues, always: tuple[str, ...]) -> dict[str, object]:
    """The part of the status that slaves and CPUs have."""
    entry: dict[str, object] = {
        "name": name,
        **{key: getattr(values, key) for key in always},
        **{key: value for key in _IF_THERE if (value := getattr(values, key))},
    }
    if values.quality is not None:
        entry["quality"] = to_builtins(values.quality)
    if qualities := qualities_of(values):
        entry["qualities"] = to_builtins(qualities)
    if values.fault is not None:
        entry["fault"] = values.fault.text
    return entry


def _cpu_status(core: BusCore, polling: CpuPolling) -> dict[str, object]:
    """The entry of an S7-200 in the status."""
    values = picture_of_cpu(core, polling)
    entry = _station_status(polling.config.name, values, ("state", "inputs_valid", "inputs_age_ms"))
    return entry | ({"injected": values.injected} if values.injected else {})


async def _outputs(bus: Bus, args: Sequence[str]) -> object:
    """Set output octets. Parses all arguments before the first one takes effect. Returns as
    :func:`~dpstack.api.control.orders.put_out`."""
    now, args = _split_now(args)
    wanted = [SetOctets(_slave_of(bus, where).address, octets) for where, octets in map(arguments.octets, args)]
    return await put_out(bus, octets_of(bus, wanted, now=now))


async def set_values(bus: Bus, args: Sequence[str]) -> object:
    """Carry out the command `set`: named outputs, and named inputs of simulated slaves. Parses all arguments before the
    first takes effect. Returns as :func:`~dpstack.api.control.orders.put_out`."""
    now, args = _split_now(args)
    wanted: list[SetOutputs] = []
    inputs: list[str] = []
    core = core_of(bus)
    of_cpus: dict[int, dict[str, Argument | None]] = {}
    for text in args:
        where, name, value = arguments.field_value(text)
        address = address_of(where, station_names(bus))
        if address in core.cpus:
            config = core.cpus[address].config
            if core.bench is not None and name not in config.output_fields:
                inputs.append(text)
                continue
            of_cpus.setdefault(address, {})[name] = _read_of_cpu(config, name, value)
            continue
        slave = bus.slave(address)
        if core.bench is not None and name in slave.config.input_fields:
            inputs.append(text)
            continue
        try:
            wanted.append(SetOutputs(slave.address, {name: slave.output_field(name).read(value)}))
        except ValueError as error:
            raise UsageError(f"{slave.who}: {error}") from None
    octets = octets_of(bus, wanted, now=now)
    if core.bench is not None and inputs:
        from dpstack.api.control.simulation_handlers import set_inputs

        set_inputs(core.bench, core, inputs)
    for address, values in of_cpus.items():
        await carry_out(bus, SetCpuValues(address, values), now=now)
    return await put_out(bus, octets) if octets else None


def _read_of_cpu(config: CpuConfig, name: str, text: str) -> Argument:
    """A value for a CPU as a person writes it. Raises UsageError."""
    try:
        return config.value(name).field.read(text)
    except ValueError as error:
        raise UsageError(f"{config.who}: {error}") from None


def station_names(bus: Bus) -> dict[int, str]:
    """The names of the slaves and of the S7-200 CPUs by address."""
    cpus = core_of(bus).cpus
    return {one.address: one.name for one in bus.slaves} | {at: one.config.name for at, one in cpus.items()}


def _split_now(args: Sequence[str]) -> tuple[bool, Sequence[str]]:
    """Whether :data:`NOW` stands in front, and the arguments behind it."""
    return (True, args[1:]) if args[0] == NOW and len(args) > 1 else (False, args)


def _is_asking(args: Sequence[str]) -> bool:
    """False for the word :data:`UNASKED`. Raises UsageError for another one."""
    if args and args[0] != UNASKED:
        raise UsageError(f"{args[0]!r}: the only word here is {UNASKED}, which sends no telegram")
    return not args


def _diag(bus: Bus, where: str, *, ask: bool) -> LongCommand:
    """The report on a station, given by address 0..126 or by the name of a slave; ``reading``: its octets.

    Without ``ask`` it is a slave of the configuration, as the master knows it already.

    Raises UsageError for this master itself, BusError while it searches its baud rate.
    """
    if bus.searching:
        raise BusError(f"{SEARCHING}: no station can be asked before")
    number = number_or_name(where)
    known = next((slave for slave in bus.slaves if number in (slave.address, slave.name)), None)
    address = known.address if known is not None else arguments.within(where, int, 0, UNADDRESSED, _STATION)
    own = bus.params.address
    if address == own:
        raise UsageError(f"station {own} is this master itself: it has no diagnosis")

    async def work() -> dict[str, object]:
        await load_beside("dpstack.api.slave.station_report")
        from dpstack.api.slave.station_report import KnownDevices, read_station, station_report

        if ask:
            reading = await read_station(bus.class2, address, own, "run", bus.snapshot.las)
        else:
            await load_beside(_KNOWN)
            from dpstack.api.control.known_stations import known_reading

            reading = known_reading(bus, address)
        config = None if known is None else known.config
        devices = KnownDevices(slave.config for slave in bus.slaves)
        return {**station_report(reading, config, devices), "reading": structs.asdict(reading)}

    async def long_command(send: Send) -> dict[str, object]:
        return await kept_alive(work(), lambda: {"state": "asking"}, send)

    return long_command


_STATION: Final = "ADDRESS: write the address of a station, 0..126, or the name of a slave"


def _why(bus: Bus, args: list[str]) -> LongCommand:
    """The story of a slave. A scan of the bus may take some seconds."""
    slave, ask = _slave_of(bus, args[0]), _is_asking(args[1:])

    async def tell() -> dict[str, object]:
        return (await bus.why(slave, ask=ask, scan=ask)).as_dict()

    return lambda send: kept_alive(tell(), lambda: {"state": slave.state.value}, send)


def _slave_of(bus: Bus, where: str) -> Slave:
    # of a CPU the bus says that it is no slave, and its state
    cpus = {cpu.address: cpu.name for cpu in bus.cpus}
    return bus.slave(address_of(where, {slave.address: slave.name for slave in bus.slaves} | cpus))


# --- the live list of a run ------------------------------------------------------------------------------------------


class ScanOrder:
    """The handler of ``scan``; one scan at a time, as each takes bus time that another one would wait for."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._under_way = False

    def __call__(self, args: list[str]) -> LongCommand:
        """Items have ``progress``: ["addresses", number asked, 127]. The result is that of ``scan --json``, and each
        station also has ``config`` (identifier octets in hex, or null) and ``name`` (in the configuration, or null).

        Slaves do not change, and data exchange goes on: the master asks in the time that a token hold leaves. With the
        word :data:`UNASKED` nobody is asked: :func:`~dpstack.api.control.known_stations.known_stations`.
        """
        if self._bus.searching:
            raise BusError(f"{SEARCHING}: a scan is possible once it is found")
        return self._carry_out if _is_asking(args) else self._known

    async def _known(self, _send: Send) -> dict[str, Any]:
        await load_beside(_KNOWN)
        from dpstack.api.control.known_stations import known_stations

        return known_stations(self._bus)

    async def _carry_out(self, send: Send) -> dict[str, Any]:
        if self._under_way:
            raise UsageError("a scan is under way already; ask again when it is over")
        self._under_way = True
        progress = ["addresses", 0, len(ALL_ADDRESSES)]
        try:
            return await kept_alive(self._scan(progress), lambda: {"progress": progress}, send)
        finally:
            self._under_way = False

    async def _scan(self, progress: list[Any]) -> dict[str, Any]:
        bus = self._bus
        found: list[Found] = []
        unreadable: set[int] = set()
        for at in range(0, len(ALL_ADDRESSES), _SCAN_PART):
            part = ALL_ADDRESSES[at : at + _SCAN_PART]
            found += await bus.scan(configs=True, addresses=part)
            unreadable |= core_of(bus).unreadable
            progress[1] = at + len(part)
        await load_beside("dpstack.api.commissioning.live_list")
        from dpstack.api.commissioning.live_list import answer_notes

        names = {slave.address: slave.name for slave in bus.slaves}
        return {
            "baud": bus.params.baud,
            "address": bus.params.address,
            "stations": [{"config": None, **one.as_dict(), "name": names.get(one.address)} for one in found],
            "unreadable": sorted(unreadable),
            "notes": list(answer_notes(found, unreadable)),
        }
