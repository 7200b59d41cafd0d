"""The [bus] table of a configuration: the keys of the bus as a whole."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Final, Literal

from dpstack.api.config.table import Key, Table, keys_of
from dpstack.params import LIMITS, MAX_STATION
from dpstack.units import BAUD_RATES, NS_PER_MS

VIRTUAL: Final = "virtual"
#: the baud rate is found by listening (see :mod:`dpstack.api.bus.find_baud`); echo is recognised
AUTO: Final = "auto"
#: ``after_stall``: Clear
SAFE: Final = "safe"
#: an application watchdog is not shorter: an event loop has pauses of some milliseconds
_LEAST_APPLICATION_MS: Final = 10
#: the longest cycle; what is shorter than possible the plan refuses
_MAX_CYCLE_MS: Final = 60_000


def _like(parameter: str, unit: str = "", hint: str = "") -> Key:
    """A key within the limits of a bus parameter."""
    low, high, _ = LIMITS[parameter]
    return Key(low, high, unit, hint)


def _baud(table: Table, name: str, key: Key) -> object:
    if table.raw(name) == AUTO:
        return AUTO
    baud = table.integer(name)
    if baud is not None and baud not in BAUD_RATES:
        near = min(BAUD_RATES, key=lambda rate: abs(rate - baud))
        known = ", ".join(map(str, BAUD_RATES))
        table.fail(name, f"{baud} is no PROFIBUS rate", f"nearest is {near}; known: {known}")
    return baud


def _cycle_ms(table: Table, name: str, key: Key) -> object:
    """More than 0: what is too short for the slaves depends on them and on the rate."""
    cycle = table.number(name, key.low, key.high)
    if cycle is not None and round(cycle * NS_PER_MS) < 1:
        table.fail(name, f"{name} = {cycle:g} is no time", "give milliseconds, or leave it out")
    return cycle


def _other_masters(table: Table, name: str, key: Key) -> object:
    value = table.raw(name)
    if not isinstance(value, (list, tuple)):
        return table.integer(name, key.low, key.high, "how many there are beside this one")
    if len(value) > MAX_STATION:
        table.fail(name, f"{name} holds {len(value)} times", f"at most {MAX_STATION} can be on a bus")
    for member in value:
        number = isinstance(member, (int, float)) and not isinstance(member, bool)
        if not number or not 0 <= member <= _MAX_CYCLE_MS:
            table.fail(
                name,
                f"{name} holds {member!r}",
                f"give the bus rotation time of each other master in ms (0..{_MAX_CYCLE_MS}), or how many there are",
            )
    return tuple(float(member) for member in value)


def _application_watchdog(table: Table, name: str, key: Key) -> object:
    limit = table.integer(name, key.low, key.high, "0 switches it off")
    if limit is not None and 0 < limit < _LEAST_APPLICATION_MS:
        table.fail(name, f"{name} = {limit} is too short", f"give {_LEAST_APPLICATION_MS} or more, or 0 for none")
    return limit


def _echo(table: Table, name: str, key: Key) -> object:
    echo = table.raw(name)
    if echo == AUTO:
        return None
    if not isinstance(echo, bool):
        table.fail(name, f"{name} = {echo!r}", 'it must be "auto", true or false')
    return echo


@dataclass(frozen=True, slots=True, kw_only=True)
class BusConfig:
    """The keys of [bus], as docs/configuration.md has them. ``port`` and ``baud`` may be missing until they are needed.

    port: a device, `socket://host:port`, `rfc2217://host:port`, or `"virtual"`: the slaves are simulated. Left out:
        `--port`
    baud: 9600, 19200, 31250, 45450, 93750, 187500, 500000, 1500000, 3000000, 6000000, 12000000; or `"auto"`: `dpstack
        run` and `open_bus` listen first, and give up after 5 s of silence: a master that is alone on its bus must give
        the rate. Left out: `--baud`
    address: the master's station address
    cycle_ms: a fixed cycle, more than 0: rounds begin equidistantly (best effort). One that is shorter than possible is
        refused with the shortest that is, see [bus-parameters.md](bus-parameters.md#a-fixed-cycle) and
        [cycle.md](cycle.md). Left out: as fast as the bus allows
    cycle_freeze: groups that every cycle begins with a FREEZE of, see [cycle.md](cycle.md#one-moment); their slaves
        have `freeze`
    cycle_sync: groups that every cycle ends with a SYNC of; their slaves have `sync`
    other_masters: the other masters of the bus, for T_TR and the plan: how many that need as long as this one, or a
        list with the bus rotation time of each in ms
    driver: `"process"`: the bus in a process of its own; `"auto"`: which is better here, see [drivers.md](drivers.md)
    t_sl: slot time. Left out: the table's, or what the slaves need
    t_tr: target rotation time. Left out: the table's, or what the slaves need
    max_retry: retries of an unanswered request. Left out: by rate
    gap: GAP factor G, 0 = off (a single master needs none). Left out: by rate
    hsa: highest station address of a master
    extra_idle_bits: further silence before every request, for slaves that find frame ends by a pause: many repetitions
        with a self-made slave ask for 60 ([two of them](foreign.md#stacks-that-were-tried-by-hand))
    after_stall: what the master does after a stall, see [below](#after-a-stall): `"safe"`: it goes to Clear, until
        `operate()` or `dpstack ctl PORT operate`; `"resume"`: it sends the old outputs again unasked
    application_watchdog_ms: how often your program has to call `bus.alive()`, see [below](#is-the-program-alive): 10 or
        more, or 0 for no such watch. `dpstack run` and `dpstack drive` refuse it
    auto_clear: go to Clear when a slave had no data exchange for `data_control_time_ms`, say which and why; Operate
        waits for all slaves, and comes back by order only
    data_control_time_ms: the Data_Control_Time
    read_only: join the ring, show who is there, never parameterise or write; enforced in front of everything that sends
    echo: whether the line returns what is sent, which is then removed; `"auto"` is as if left out. Left out: found out
        from the first telegrams
    rs485: `false`: leave the RS-485 mode of the port's driver as it is (a converter behind an RS-232 port switches by
        itself). Otherwise it is switched on where the driver has it, RTS while sending, unless it is on already
    event_char: `true`: an FTDI adapter delivers at every ED octet instead of waiting for its timer (an experiment)
    host_slack_ms: how late the port may deliver before an answer counts as missing. Left out: 50 on a pty or socket; on
        an adapter 60, once measured three times its p99.9 (20 to 60)
    """

    port: Annotated[str | None, Key()] = None
    baud: Annotated[int | Literal["auto"] | None, Key(read=_baud)] = None
    address: Annotated[int, _like("address")] = 2
    cycle_ms: Annotated[float | None, Key(0, _MAX_CYCLE_MS, read=_cycle_ms)] = None
    cycle_freeze: Annotated[tuple[int, ...], Key(1, 8)] = ()
    cycle_sync: Annotated[tuple[int, ...], Key(1, 8)] = ()
    other_masters: Annotated[int | tuple[float, ...], Key(0, MAX_STATION, read=_other_masters)] = 0
    driver: Annotated[Literal["auto", "asyncio", "process"], Key()] = "auto"
    t_sl: Annotated[int | None, _like("t_sl", "bit times")] = None
    t_tr: Annotated[int | None, _like("t_tr", "bit times")] = None
    max_retry: Annotated[int | None, _like("max_retry")] = None
    gap: Annotated[int | None, _like("gap", hint="0 switches the GAP off")] = None
    hsa: Annotated[int, _like("hsa")] = 126
    extra_idle_bits: Annotated[int, _like("extra_idle")] = 0
    after_stall: Annotated[Literal["safe", "resume"], Key()] = "safe"
    application_watchdog_ms: Annotated[int, Key(0, 655_350, read=_application_watchdog)] = 0
    auto_clear: Annotated[bool, Key()] = False
    data_control_time_ms: Annotated[int, Key(10, 655_350)] = 1000
    read_only: Annotated[bool, Key()] = False
    echo: Annotated[bool | None, Key(read=_echo)] = None
    rs485: Annotated[bool, Key()] = True
    event_char: Annotated[bool, Key()] = False
    host_slack_ms: Annotated[float | None, Key(0, 10_000)] = None

    @property
    def cycle_ns(self) -> int:
        """The fixed cycle in ns, 0 where the bus runs as fast as it can."""
        return 0 if self.cycle_ms is None else round(self.cycle_ms * NS_PER_MS)


def read_bus(table: Table) -> BusConfig:
    """Check it. Raises ConfigError, one line."""
    return BusConfig(**table.read(keys_of(BusConfig)))
