"""The [bus] table of a configuration: the keys of the bus as a whole, read and checked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, Literal

from dpstack.api.config.table import Table
from dpstack.params import MAX_STATION, MAX_T_SL
from dpstack.units import BAUD_RATES, NS_PER_MS

VIRTUAL: Final = "virtual"
#: the baud rate is found by listening (see :mod:`dpstack.api.bus.find_baud`); echo is recognised
AUTO: Final = "auto"
_DRIVERS: Final = ("auto", "asyncio", "process")
#: ``after_stall``: Clear, or the old outputs again
SAFE: Final = "safe"
_AFTER_STALL: Final = (SAFE, "resume")
#: an application watchdog is not shorter: an event loop has pauses of some milliseconds
_LEAST_APPLICATION_MS: Final = 10
_KEYS: Final = (
    "port",
    "baud",
    "address",
    "cycle_ms",
    "cycle_freeze",
    "cycle_sync",
    "other_masters",
    "driver",
    "t_sl",
    "max_retry",
    "gap",
    "hsa",
    "t_tr",
    "host_slack_ms",
    "extra_idle_bits",
    "echo",
    "event_char",
    "rs485",
    "after_stall",
    "application_watchdog_ms",
    "auto_clear",
    "data_control_time_ms",
    "read_only",
)
#: the longest cycle; what is shorter than possible the plan refuses
_MAX_CYCLE_MS: Final = 60_000


@dataclass(frozen=True, slots=True, kw_only=True)
class BusConfig:
    """The [bus] table. ``port`` and ``baud`` may be missing until they are needed. Times in bit times unless named.

    ``cycle_ms`` None: free running. ``other_masters``: so many that need as long as this one, or the bus rotation
    time of each in ms. ``cycle_freeze``, ``cycle_sync``: groups that every cycle begins with a FREEZE of, and ends with
    a SYNC of. ``after_stall``: "safe" or "resume". ``application_watchdog_ms``: 0 is off.
    """

    port: str | None = None
    baud: int | Literal["auto"] | None = None
    address: int = 2
    cycle_ms: float | None = None
    cycle_freeze: tuple[int, ...] = ()
    cycle_sync: tuple[int, ...] = ()
    other_masters: int | tuple[float, ...] = 0
    driver: str = "auto"
    t_sl: int | None = None
    t_tr: int | None = None
    max_retry: int | None = None
    gap: int | None = None
    hsa: int = 126
    host_slack_ms: float | None = None
    extra_idle_bits: int = 0
    after_stall: str = SAFE
    application_watchdog_ms: int = 0
    auto_clear: bool = False
    data_control_time_ms: int = 1000
    read_only: bool = False
    echo: bool | None = None  # None: found out at start
    event_char: bool = False
    rs485: bool = True

    @property
    def cycle_ns(self) -> int:
        """The fixed cycle in ns, 0 where the bus runs as fast as it can."""
        return 0 if self.cycle_ms is None else round(self.cycle_ms * NS_PER_MS)


def read_bus(table: Table) -> BusConfig:
    """Check it. Raises ConfigError, one line."""
    table.check_keys(_KEYS)
    driver = table.text("driver") or "auto"
    if driver not in _DRIVERS:
        table.fail("driver", f"unknown driver {driver!r}", 'it must be "auto", "asyncio" or "process"')
    after_stall = table.text("after_stall") or SAFE
    if after_stall not in _AFTER_STALL:
        table.fail("after_stall", f"unknown after_stall {after_stall!r}", 'it must be "safe" or "resume"')
    return BusConfig(
        port=table.text("port"),
        baud=_baud(table),
        address=_or(table.integer("address", 0, MAX_STATION), 2),
        cycle_ms=_cycle_ms(table),
        cycle_freeze=table.integers("cycle_freeze", 1, 8),
        cycle_sync=table.integers("cycle_sync", 1, 8),
        other_masters=_other_masters(table),
        driver=driver,
        t_sl=table.integer("t_sl", 37, MAX_T_SL),
        t_tr=table.integer("t_tr", 256, 16_777_960),
        max_retry=table.integer("max_retry", 0, 15),
        gap=table.integer("gap", 0, 100, "0 switches the GAP off"),
        hsa=_or(table.integer("hsa", 1, 126), 126),
        host_slack_ms=table.number("host_slack_ms", 0, 10_000),
        extra_idle_bits=_or(table.integer("extra_idle_bits", 0, 100_000), 0),
        after_stall=after_stall,
        application_watchdog_ms=_application_watchdog(table),
        auto_clear=table.flag("auto_clear", False),
        data_control_time_ms=_or(table.integer("data_control_time_ms", 10, 655_350), 1000),
        read_only=table.flag("read_only", False),
        echo=_echo(table),
        event_char=table.flag("event_char", False),
        rs485=table.flag("rs485", True),
    )


def _cycle_ms(table: Table) -> float | None:
    """More than 0: what is too short for the slaves depends on them and on the rate."""
    cycle = table.number("cycle_ms", 0, _MAX_CYCLE_MS)
    if cycle is not None and round(cycle * NS_PER_MS) < 1:
        table.fail("cycle_ms", f"cycle_ms = {cycle:g} is no time", "give milliseconds, or leave it out")
    return cycle


def _application_watchdog(table: Table) -> int:
    key = "application_watchdog_ms"
    limit = _or(table.integer(key, 0, 655_350, "0 switches it off"), 0)
    if 0 < limit < _LEAST_APPLICATION_MS:
        table.fail(key, f"{key} = {limit} is too short", f"give {_LEAST_APPLICATION_MS} or more, or 0 for none")
    return limit


def _other_masters(table: Table) -> int | tuple[float, ...]:
    value = table.raw("other_masters")
    if not isinstance(value, (list, tuple)):
        return _or(table.integer("other_masters", 0, MAX_STATION, "how many there are beside this one"), 0)
    if len(value) > MAX_STATION:
        table.fail("other_masters", f"other_masters holds {len(value)} times", f"at most {MAX_STATION} can be on a bus")
    for member in value:
        number = isinstance(member, (int, float)) and not isinstance(member, bool)
        if not number or not 0 <= member <= _MAX_CYCLE_MS:
            table.fail(
                "other_masters",
                f"other_masters holds {member!r}",
                f"give the bus rotation time of each other master in ms (0..{_MAX_CYCLE_MS}), or how many there are",
            )
    return tuple(float(member) for member in value)


def _echo(table: Table) -> bool | None:
    echo = table.raw("echo")
    if echo is None or echo == AUTO:
        return None
    if not isinstance(echo, bool):
        table.fail("echo", f"echo = {echo!r}", 'it must be "auto", true or false')
    return echo


def _baud(table: Table) -> int | Literal["auto"] | None:
    if table.raw("baud") == AUTO:
        return AUTO
    baud = table.integer("baud")
    if baud is not None and baud not in BAUD_RATES:
        near = min(BAUD_RATES, key=lambda rate: abs(rate - baud))
        table.fail("baud", f"{baud} is no PROFIBUS rate", f"nearest is {near}; known: {_rates()}")
    return baud


def _rates() -> str:
    return ", ".join(map(str, BAUD_RATES))


def _or(value: int | None, default: int) -> int:
    return default if value is None else value
