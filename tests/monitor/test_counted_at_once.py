"""Many transmissions counted at once: the same as one by one, whatever is on the line."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from changed_traffic import BAUD, in_columns, recorded, traffic
from hypothesis import example, given, settings
from recordings import ASM754, WHOLE

from dpstack.capture.timing import FILE, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.fdl.telegram import Telegram
from dpstack.monitor import exchanges
from dpstack.monitor.counters import Counters
from dpstack.monitor.monitor import Happening, Monitor
from dpstack.units import NS_PER_S


def plain(value: Any, seen: frozenset[int] = frozenset()) -> Any:
    """All that an object holds, without what it keeps of octets, and without functions."""
    if isinstance(value, dict):
        return {key: plain(one, seen) for key, one in value.items()}
    if isinstance(value, (list, set, tuple)):
        return [plain(one, seen) for one in value]
    if not type(value).__module__.startswith("dpstack.") or isinstance(value, (int, str)):
        return None if isinstance(value, Callable) else value  # type: ignore[arg-type]
    if id(value) in seen:
        return "above"
    seen |= {id(value)}
    names = [name for kind in type(value).__mro__ for name in getattr(kind, "__slots__", ())]
    found = {name: getattr(value, name) for name in names if hasattr(value, name)} | getattr(value, "__dict__", {})
    return {name: plain(one, seen) for name, one in found.items() if name != "_known"}


def counted(batches: list[list[Transmission]], add_all: bool) -> tuple[Any, list[Happening], dict[str, object]]:
    """All that a monitor knows after them, its events, and the summary."""
    events: list[Happening] = []
    monitor = Monitor(LineTiming(FILE, 1), on_event=events.append)
    for batch in batches:
        if add_all:
            for part in in_columns(batch):
                monitor.add_all(part)
        else:
            for one in batch:
                monitor.add(one)
    return plain(monitor.counters), events, monitor.summary()


@settings(max_examples=25)
@given(recorded())
@example([list(traffic())])
def test_many_at_once_count_as_one_after_the_other(batches: list[list[Transmission]]) -> None:
    assert counted(batches, add_all=True) == counted(batches, add_all=False)


def test_recordings_at_once_count_as_one_after_the_other() -> None:
    """Those of real devices, one after the other."""
    heard = list(traffic())
    for recording in (*WHOLE, ASM754):
        begin = (heard[-1].t_ns or 0) + NS_PER_S
        heard += [Transmission(octets, begin + n * 997_123, BAUD) for n, (_, octets) in enumerate(recording.lines)]
    assert counted([heard], add_all=True) == counted([heard], add_all=False)


def test_most_of_a_bus_is_counted_without_the_long_way(monkeypatch: pytest.MonkeyPatch) -> None:
    long_way: list[Transmission] = []
    count = Counters._count

    def noted(self: Counters, one: Transmission, telegram: Telegram | None) -> None:
        long_way.append(one)
        count(self, one, telegram)

    monkeypatch.setattr(Counters, "_count", noted)
    (columns,) = in_columns(traffic())
    Counters().add_all(columns)
    assert len(long_way) < len(traffic()) / 2


def test_telegrams_that_never_repeat_do_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(exchanges, "_KEPT_TELEGRAMS", 16)
    counters = Counters()
    for number, one in enumerate(traffic()):
        (columns,) = in_columns((one, Transmission(b"\x10" + number.to_bytes(4, "big"), one.t_ns, BAUD)))
        counters.add_all(columns)
        assert len(counters._known) <= 16
