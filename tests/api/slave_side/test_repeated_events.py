"""Lines of `dpstack sim` that repeat themselves, and its last refusal in `ctl status`."""

from __future__ import annotations

import asyncio

import pytest
from simulated_kit import SC, Asked

from dpstack.api.slave_side.repeated_events import RepeatedEvents, times_text
from dpstack.api.slave_side.virtual_bench import sim_event_json
from dpstack.trace import Event, Notice
from dpstack.units import NS_PER_S

pytestmark = pytest.mark.virtual_time

VALVES: dict[str, object] = {"name": "valves", "address": 8, "ident": 0x1234, "config": "20 10"}
_PRM, _CFG, _GOOD = "3D 3E 80 00 00 0B 12 34 00", "3E 3E 20 20 10", "3E 3E 20 10"


class Tried:
    """A master that configures a simulated slave once a second; the lines that `dpstack sim` writes of it."""

    def __init__(self) -> None:
        self.asked = Asked(VALVES)
        self.asked.unit.app.take_events()
        self.passed: list[tuple[Event, int]] = []
        self.repeated = RepeatedEvents(lambda event, times: self.passed.append((event, times)))

    async def attempt(self, config: str = _CFG, pause_s: float = 1.0) -> None:
        for unit in (_PRM, config):
            assert self.asked.ask(unit) == SC
        now = round(asyncio.get_running_loop().time() * NS_PER_S)
        for event in self.asked.unit.app.take_events():
            self.repeated.publish(
                type(event)(**{n: getattr(event, n) for n in event.__struct_fields__} | {"t_ns": now})
            )
        await asyncio.sleep(pause_s)

    @property
    def texts(self) -> list[str]:
        return [event.text + times_text(times) for event, times in self.passed]


async def test_a_master_that_tries_again_and_again_is_counted() -> None:
    tried = Tried()
    for _ in range(700):
        await tried.attempt()
    tried.repeated.report()
    assert tried.texts[:5] == [
        "slave 8 (valves): wait_cfg (Set_Prm with Lock_Req accepted, master 2)",
        "slave 8 (valves): Chk_Cfg of master 2 refused: configuration 20 20 10 is not 20 10",
        "slave 8 (valves): wait_prm (Chk_Cfg refused)",
        "slave 8 (valves): wait_cfg (Set_Prm with Lock_Req accepted, master 2)",
        "slave 8 (valves): wait_prm (Chk_Cfg refused)",
    ]
    assert len(tried.texts) < 50
    assert tried.texts[-1].startswith("slave 8 (valves): wait_prm (Chk_Cfg refused) (")
    assert tried.texts[-1].endswith(" times since this line was written)")
    assert sum(times for _, times in tried.passed) == 1401  # nothing is lost: the refusal, and twice 700 states


async def test_the_last_state_is_written_within_a_second() -> None:
    """Also if it came often before; after a pause each line is written at once again."""
    tried = Tried()
    for _ in range(6):
        await tried.attempt(_GOOD, 0.01)
    await asyncio.sleep(1)
    event, times = tried.passed[-1]
    assert (sim_event_json(event, 1.0)["state"], times) == ("data_exchange", 3)
    await asyncio.sleep(11)
    before = len(tried.passed)
    await tried.attempt(_GOOD, 0)
    assert [text.split()[3] for text in tried.texts[before:]] == ["wait_cfg", "data_exchange"]


async def test_orders_are_never_counted() -> None:
    passed: list[int] = []
    repeated = RepeatedEvents(lambda _, times: passed.append(times))
    for at in range(20):
        repeated.publish(Notice(t_ns=at, source="ctl", message="the same"))
    assert passed == 20 * [1]


def test_status_has_the_last_refusal_until_data_exchange() -> None:
    asked = Asked(VALVES)
    assert "refused" not in asked.bench.status_of(8)
    for _ in range(3):
        asked.ask(_PRM)
        asked.ask(_CFG)
    said = "wait_prm: configuration 20 20 10 is not 20 10 (Chk_Cfg of master 2, 3 times)"
    assert asked.bench.status_of(8)["refused"] == said
    asked.ask("3D 3E 80 00 00 0B 12 35 00")
    assert asked.bench.status_of(8)["refused"] == (
        "wait_prm: octets 5-6: ident number 0x1235, this device is 0x1234 (Set_Prm of master 2)"
    )
    asked.bring_up("20 10")
    assert "refused" not in asked.bench.status_of(8)
