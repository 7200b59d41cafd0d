"""The [bus] table: keys of the whole bus."""

from typing import Annotated, Final, Literal

from msgspec import Struct

from dpstack.params import BUS_LIMITS, MAX_STATION
from dpstack.text import brief
from dpstack.toml.table import Key, Source, Table, is_integer, keys_of
from dpstack.units import AUTO, BAUD_RATES, NS_PER_MS, NS_PER_S

#: ``after_stall``: Clear
SAFE: Final = "safe"
#: an application watchdog is not shorter: an event loop has pauses of some milliseconds
_LEAST_APPLICATION_MS: Final = 10
#: the longest cycle; the plan refuses a cycle that is too short
_MAX_CYCLE_MS: Final = 60_000
#: Linux numbers no more processors
_MAX_CPU: Final = 8191


def _like(parameter: str, unit: str = "", hint: str = "") -> Key:
    """A key within the limits of a bus parameter."""
    low, high, _ = BUS_LIMITS[parameter]
    return Key(low, high, unit, hint)


def _baud(table: Table, name: str, key: Key) -> object:
    if table.raw(name) == AUTO:
        return AUTO
    baud = table.integer(name)
    if baud not in BAUD_RATES:
        near = min(BAUD_RATES, key=lambda rate: abs(rate - baud))
        known = ", ".join(map(str, BAUD_RATES))
        table.fail(name, f"{baud} is no PROFIBUS rate", f"nearest is {near}; known: {known}")
    return baud


def _cycle_ms(table: Table, name: str, key: Key) -> object:
    """Reader of ``cycle_ms``, more than 0; the plan checks it against the slaves and the rate."""
    cycle = table.number(name, key.low, key.high)
    if round(cycle * NS_PER_MS) < 1:
        table.fail(name, f"{name} = {cycle:g} is no time", "give milliseconds, or leave it out")
    return cycle


def _other_masters(table: Table, name: str, key: Key) -> object:
    value = table.raw(name)
    if not isinstance(value, (list, tuple)):
        return table.integer(name, key.low, key.high, "how many there are beside this one")
    if len(value) > MAX_STATION:
        table.fail(name, f"{name} holds {len(value)} times", f"at most {MAX_STATION} can be on a bus")
    for member in value:
        number = isinstance(member, float) or is_integer(member)
        if not number or not 0 <= member <= _MAX_CYCLE_MS:
            table.fail(
                name,
                f"{name} holds {brief(member)}",
                f"give the bus rotation time of each other master in ms (0..{_MAX_CYCLE_MS}), or how many there are",
            )
    return tuple(float(member) for member in value)


def _cpu(table: Table, name: str, key: Key) -> object:
    value = table.raw(name)
    if is_integer(value):
        return table.integer(name, key.low, key.high, "0 is the first processor")
    numbers = value if isinstance(value, (list, tuple)) else ()
    if not numbers or not all(is_integer(number) and key.low <= number <= key.high for number in numbers):
        table.fail(
            name, f"{name} = {brief(value)}", "give the number of a processor, 0 for the first one, or a list of them"
        )
    return tuple(sorted(set(numbers)))


def _application_watchdog(table: Table, name: str, key: Key) -> object:
    limit = table.integer(name, key.low, key.high, "0 switches it off")
    if 0 < limit < _LEAST_APPLICATION_MS:
        table.fail(name, f"{name} = {limit} is too short", f"give {_LEAST_APPLICATION_MS} or more, or 0 for none")
    return limit


def _echo(table: Table, name: str, key: Key) -> object:
    echo = table.raw(name)
    if echo == AUTO:
        return None
    if not isinstance(echo, bool):
        table.fail(name, f"{name} = {brief(echo)}", 'it must be "auto", true or false')
    return echo


class BusConfig(Struct, frozen=True, kw_only=True):
    """The keys of [bus], as docs/reference/configuration.md has them. ``port`` and ``baud`` may be missing until they
    are needed.

    port: a device, `socket://host:port`, `rfc2217://host:port`, or `"virtual"`: dpstack simulates the slaves. Left out:
        `--port`
    baud: 9600, 19200, 31250, 45450, 93750, 187500, 500000, 1500000, 3000000, 6000000, 12000000; or `"auto"`: `dpstack
        run` and `open_bus` listen first, and give up after 5 s of silence. A master that is alone on its bus must give
        the rate. Left out: `--baud`
    address: the master's station address. Left out: 2; 0 in a plant with [S7-200 CPUs](#ppi)
    cycle_ms: a fixed cycle, more than 0: rounds begin at equal intervals (best effort). A cycle that is too short is
        refused, and the message gives the shortest possible one; see
        [bus-parameters.md](bus-parameters.md#a-fixed-cycle) and [cycle.md](cycle.md). Left out: as fast as the bus
        allows
    cycle_freeze: groups that get FREEZE at the beginning of every cycle, see [cycle.md](cycle.md#one-moment); their
        slaves need `freeze`
    cycle_sync: groups that get SYNC at the end of every cycle; their slaves need `sync`
    clock_sync_s: send the time of this computer to all stations every so many seconds, as a class 3 master (Time_Event
        and Clock_Value of DP-V2), see [clock.md](clock.md). Devices want certain intervals: 1, 10 and 60 s suit all
        that are known. Left out: no time is sent
    other_masters: the other masters of the bus, for T_TR and the plan: their number, if each needs as long as this one,
        or a list with the bus rotation time of each in ms
    driver: `"process"`: the bus in a process of its own; `"asyncio"`: in the event loop of the application; `"auto"`:
        the better one for this computer and port, see [drivers.md](drivers.md)
    cpu: the processor of the bus process, or a list of them, as `/proc/cpuinfo` numbers them. An isolated one has no
        other work (see [real-time.md](real-time.md#processors)). With `driver = "auto"` the key asks for a bus process.
        Left out: all that the program may run on
    t_sl: slot time. Left out: that of the [table](bus-parameters.md), or more if the slaves need more
    t_tr: target rotation time. Left out: that of the [table](bus-parameters.md), or more if the masters need more
    max_retry: retries of an unanswered request. Left out: by rate
    gap: GAP factor G, 0 = off (a single master needs none). Left out: by rate
    hsa: highest station address of a master
    extra_idle_bits: additional silence before every request, for slaves that find the end of a telegram by a pause. If
        a self-made slave causes many repetitions, try 60 ([two such slaves](foreign.md#stacks-that-were-tried-by-hand))
    after_stall: what the master does after a stall, see [below](#after-a-stall): `"safe"`: it goes to Clear, until
        `operate()` or `dpstack ctl PORT operate`; `"resume"`: it sends the old outputs again by itself
    application_watchdog_ms: the longest time between two calls of `bus.alive()` by your program, see
        [below](#is-the-program-alive): 10 or more; 0 switches this watchdog off. `dpstack run` and `dpstack drive`
        refuse the key
    on_connector_loss: what becomes of outputs and drives that a connector (MQTT, OPC UA, EPICS) has ordered when it
        ends by a fault or hangs, see [below](#a-connector-that-is-lost): `"safe"`: outputs get their safe values,
        drives stop; `"keep"`: they stay as ordered
    auto_clear: go to Clear when a slave had no data exchange for `data_control_time_ms`, and report which slave and
        why. `operate()` waits until all slaves are in data exchange. The master does not go back to Operate by itself
    data_control_time_ms: the Data_Control_Time
    read_only: join the ring and show the stations, but never parameterise or write; a guard in front of every sender
        enforces this
    echo: whether the line returns the octets that are sent; the port then removes them. `"auto"` means the default.
        Left out: found out from the first telegrams, and anew when it begins or ends
    rs485: `false`: leave the RS-485 mode of the port's driver unchanged (a converter behind an RS-232 port switches by
        itself). `true`: switch it on if the driver has it, with RTS while sending, unless it is on already
    event_char: `true`: an FTDI adapter delivers at every ED octet instead of waiting for its timer (experimental)
    host_slack_ms: how late the port may deliver an answer before it counts as missing. Left out: 50 on a pty or socket;
        on an adapter 60, after its measurement 3 x p99.9 (20 to 60)
    """

    port: str | None = None
    baud: Annotated[int | Literal["auto"] | None, Key(read=_baud)] = None
    address: Annotated[int, _like("address")] = 2
    cycle_ms: Annotated[float | None, Key(0, _MAX_CYCLE_MS, read=_cycle_ms)] = None
    cycle_freeze: Annotated[tuple[int, ...], Key(1, 8)] = ()
    cycle_sync: Annotated[tuple[int, ...], Key(1, 8)] = ()
    clock_sync_s: Annotated[float | None, Key(1, 3600)] = None
    other_masters: Annotated[int | tuple[float, ...], Key(0, MAX_STATION, read=_other_masters)] = 0
    driver: Literal["auto", "asyncio", "process"] = "auto"
    cpu: Annotated[int | tuple[int, ...] | None, Key(0, _MAX_CPU, read=_cpu)] = None
    t_sl: Annotated[int | None, _like("t_sl", "bit times")] = None
    t_tr: Annotated[int | None, _like("t_tr", "bit times")] = None
    max_retry: Annotated[int | None, _like("max_retry")] = None
    gap: Annotated[int | None, _like("gap", hint="0 switches the GAP off")] = None
    hsa: Annotated[int, _like("hsa")] = 126
    extra_idle_bits: Annotated[int, _like("extra_idle")] = 0
    after_stall: Literal["safe", "resume"] = "safe"
    application_watchdog_ms: Annotated[int, Key(0, 655_350, read=_application_watchdog)] = 0
    on_connector_loss: Literal["safe", "keep"] = "safe"
    auto_clear: bool = False
    data_control_time_ms: Annotated[int, Key(10, 655_350)] = 1000
    read_only: bool = False
    echo: Annotated[bool | None, Key(read=_echo)] = None
    rs485: bool = True
    event_char: bool = False
    host_slack_ms: Annotated[float | None, Key(0, 10_000)] = None

    @property
    def cpus(self) -> tuple[int, ...]:
        """The processors of the bus process, empty for all that the program may run on."""
        return (self.cpu,) if isinstance(self.cpu, int) else self.cpu or ()

    @property
    def clock_sync_ns(self) -> int:
        """The interval of the time that is sent, in ns, 0 if none is."""
        return 0 if self.clock_sync_s is None else round(self.clock_sync_s * NS_PER_S)

    @property
    def cycle_ns(self) -> int:
        """The fixed cycle in ns, 0 if the bus runs as fast as it can."""
        return 0 if self.cycle_ms is None else round(self.cycle_ms * NS_PER_MS)


def read_bus(source: Source, data: object, title: str = "[bus]") -> BusConfig:
    """Check the table ``data`` of ``source``; ``title`` names it in messages. Raises ConfigError, one line."""
    return BusConfig(**Table(source, ("bus",), data, title).read(keys_of(BusConfig)))
