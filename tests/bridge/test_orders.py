"""Orders of connectors: allowed by name, no older than their limit, once, one at a time a slave; the run judges
values."""

from __future__ import annotations

import asyncio
import dataclasses
from typing import Any

import pytest
from api_kit import in_virtual_time

from dpstack.bridge.orders import MOST_OF_A_SLAVE, Orders, Refusal, check_allowed, is_allowed
from dpstack.errors import ConfigError, SlaveError, UsageError
from dpstack.plant.orders import DriveOrder, RefusedOrder, SetOutputs
from dpstack.plant.tree import PlantTree
from dpstack.trace import Severity

NOW = 1_700_000_000.0


def plant(*, read_only: bool = False, names: tuple[str, str] = ("hoist", "valves")) -> dict[str, Any]:
    lamp = {"name": "lamp", "type": "bool", "at": "bool@0.1"}
    speed = {"name": "speed", "type": "u8", "at": "u8@1"}
    slaves = {
        "3": {"name": names[0], "drive": {"profile": "demag-dedrive"}},
        "8": {"name": names[1], "outputs": [lamp, speed], "inputs": [lamp | {"name": "level"}]},
    }
    return {"plant": {"started": NOW, "baud": 500_000, "read_only": read_only, "slaves": slaves}}


def snapshot(*gone: str) -> dict[str, Any]:
    """All slaves are in data exchange, but those of ``gone``."""
    fine = {"state": "data_exchange", "inputs_valid": True, "inputs_age_ms": 1.0, "inputs_limit_ms": 100.0}
    slaves = {address: fine | ({"state": "offline"} if address in gone else {}) for address in ("3", "8")}
    return {"snapshot": {"t": 1.0, "whole": True, "bus": {"stale": False, "mode": "operate"}, "slaves": slaves}}


class Run:
    """Carries orders out slowly, and keeps them."""

    def __init__(self, *allow: str, seconds: float = 0.0, read_only: bool = False) -> None:
        self.tree = PlantTree()
        self.tree.apply(plant(read_only=read_only), 0.0)
        self.tree.apply(snapshot(), 0.0)
        self.seconds = seconds
        self.carried: list[SetOutputs | DriveOrder] = []
        self.at_once = self.most_at_once = 0
        self.told: list[tuple[str, Severity]] = []
        self.refused: list[RefusedOrder] = []
        self.begun = asyncio.get_running_loop().time()
        self.orders = Orders(
            self.tree,
            self.carry_out,
            allow,
            now=self.now,
            tell=lambda text, severity: self.told.append((text, severity)),
            refused=self.refused.append,
            origin="mqtt",
        )

    def now(self) -> float:
        return NOW + asyncio.get_running_loop().time() - self.begun

    async def carry_out(self, order: SetOutputs | DriveOrder) -> None:
        self.at_once += 1
        self.most_at_once = max(self.most_at_once, self.at_once)
        try:
            await asyncio.sleep(self.seconds)
            if isinstance(order, SetOutputs) and order.values.get("speed") == 200:
                raise UsageError("valves: speed = 200 is outside 0..100")
            if order == SetOutputs(8, {"speed": 202}):
                raise SlaveError(8, "slave 8 is not in data exchange: it is in diagnosis")
            if order == SetOutputs(8, {"speed": 201}):
                raise ZeroDivisionError("\x1b[2J")
        finally:
            self.at_once -= 1
        self.carried.append(order)

    async def reason(self, name: str, value: object = None, *, made_at: float | None = None) -> str:
        result = await self.orders.give(name, value, made_at=made_at)
        assert (result.result == "done") == (not result.reason)
        return result.reason


@in_virtual_time
async def test_only_what_is_listed_is_carried_out() -> None:
    run = Run("valves.lamp", "hoist.*")
    assert {one.name for one in run.orders.allowed} == {
        "valves.lamp",
        *(f"hoist.{word}" for word in ("start", "stop", "quick_stop", "coast", "acknowledge", "speed")),
    }
    assert all(run.orders.takes(one) == (one in run.orders.allowed) for one in run.tree.orders.values())
    assert not run.orders.takes(dataclasses.replace(run.orders.allowed[0], slave=4))
    assert await run.reason("valves.lamp", True) == ""
    assert await run.reason("hoist.start") == ""
    assert await run.reason("hoist.speed", 0.5) == ""
    assert run.carried == [SetOutputs(8, {"lamp": True}), DriveOrder(3, "start"), DriveOrder(3, "speed", 0.5)]
    for name in ("valves.speed", "valves.*", "hoist", "valves", "", "valves.lamp.on", "\x1b[2J.start"):
        assert await run.reason(name, 1) == "it is not in allow_commands"
    assert await run.reason("hoist.level", 1) == "the plant has no such order"
    assert len(run.carried) == 3
    assert all(text.isprintable() for text, _ in run.told)


@in_virtual_time
async def test_types_and_ranges_are_judged_by_plant_and_run() -> None:
    run = Run("valves.*", "hoist.*")
    assert await run.reason("valves.lamp", "on") == "valves.lamp takes bool, not 'on'"
    assert await run.reason("valves.speed", -1) == "valves.speed takes u8, not -1"
    assert await run.reason("valves.speed", [1]) == "a list is no value of an order"
    assert await run.reason("valves.speed", 200) == "valves: speed = 200 is outside 0..100"
    assert await run.reason("valves.speed", 201) == "ZeroDivisionError: \\x1b[2J"
    # the run knows it earlier than the tree
    absent = await run.orders.give("valves.speed", 202, made_at=None)
    assert absent.reason == "slave 8 is not in data exchange: it is in diagnosis"
    assert absent.kind is Refusal.NO_EXCHANGE
    # a connector writes a value to an order without an argument: nothing starts because of false
    assert await run.reason("hoist.start", False) == "hoist.start takes true, not False"
    assert await run.reason("hoist.start", True) == ""
    assert run.carried == [DriveOrder(3, "start")]


@in_virtual_time
async def test_the_age_is_judged_when_it_comes_and_when_its_turn_has_come() -> None:
    run = Run("valves.*", seconds=1.5)
    assert await run.reason("valves.lamp", True, made_at=NOW - 2.1) == (
        "it is 2.1 s old by the clock of this computer; 2 s are allowed"
    )
    assert await run.reason("valves.lamp", True, made_at=NOW + 7) == (
        "its time is 7.0 s ahead of the clock of this computer: set the clocks"
    )
    assert "clock" in await run.reason("valves.lamp", True, made_at=float("nan"))
    assert "clock" in await run.reason("valves.lamp", True, made_at=float("-inf"))
    first = asyncio.ensure_future(run.reason("valves.speed", 1, made_at=NOW))
    second = asyncio.ensure_future(run.reason("valves.speed", 2, made_at=NOW + 0.1))
    third = asyncio.ensure_future(run.reason("valves.speed", 3, made_at=NOW + 0.2))
    assert (await first, await second) == ("", "")
    assert await third == "it is 2.8 s old by the clock of this computer; 2 s are allowed"
    assert run.carried == [SetOutputs(8, {"speed": 1}), SetOutputs(8, {"speed": 2})]
    assert run.most_at_once == 1


@in_virtual_time
async def test_a_sender_whose_clock_is_ahead_may_not_wait_for_longer_than_others() -> None:
    run = Run("valves.*", seconds=1.5)
    given = [asyncio.ensure_future(run.reason("valves.speed", n, made_at=NOW + 1.9 + n / 100)) for n in range(3)]
    outputs = asyncio.ensure_future(run.orders.give_outputs([("valves.lamp", True)], made_at=NOW + 1.9))
    assert [await one for one in given] == ["", "", "it has been on its way for 3.0 s; 2 s are allowed"]
    assert [one.reason for one in await outputs] == ["it has been on its way for 3.0 s; 2 s are allowed"]
    assert run.carried == [SetOutputs(8, {"speed": 0}), SetOutputs(8, {"speed": 1})]


@in_virtual_time
async def test_a_clock_that_is_set_back_meanwhile_makes_no_order_younger() -> None:
    run = Run("valves.*", seconds=2.5)
    first = asyncio.ensure_future(run.reason("valves.speed", 1, made_at=NOW))
    second = asyncio.ensure_future(run.reason("valves.lamp", True, made_at=NOW))
    await asyncio.sleep(1.0)
    run.begun += 2.0
    assert await first == ""
    assert await second == "it has been on its way for 2.5 s; 2 s are allowed"


@in_virtual_time
async def test_no_order_is_carried_out_twice() -> None:
    run = Run("valves.*", "hoist.*")
    for _ in range(3):
        await run.reason("valves.lamp", True, made_at=NOW - 1)
    assert (
        await run.reason("valves.lamp", True, made_at=NOW - 1) == "an order with this name and time was given already"
    )
    assert await run.reason("valves.speed", 1, made_at=NOW - 1) == ""
    assert len(run.carried) == 2
    # many orders of other times push none of them out
    for number in range(2000):
        await run.reason("valves.speed", 1, made_at=NOW + number / 1e6)
    assert (
        await run.reason("valves.lamp", True, made_at=NOW - 1) == "an order with this name and time was given already"
    )
    assert await run.reason("valves.speed", 5, made_at=NOW + 0.5) == "too many orders have come"
    assert await run.reason("hoist.stop", made_at=NOW + 0.5) == ""
    await asyncio.sleep(4.1)
    assert await run.reason("valves.speed", 6, made_at=NOW + 4.0) == ""


@in_virtual_time
async def test_outputs_of_one_message_are_one_order() -> None:
    run = Run("valves.*", "hoist.*", seconds=1.0)

    async def given(*orders: tuple[str, object], made_at: float = NOW) -> list[str]:
        results = await run.orders.give_outputs(orders, made_at=made_at)
        assert [one.name for one in results] == [name for name, _ in orders]
        return [one.reason for one in results]

    assert [run.orders.sets_output(one) for one in ("valves.lamp", "hoist.start", "x")] == [True, False, False]
    assert await given(("valves.lamp", True), ("valves.speed", 7)) == ["", ""]
    assert run.carried == [SetOutputs(8, {"lamp": True, "speed": 7})]
    # those that are refused before the run sees them leave the others
    known = "an order with this name and time was given already"
    assert await given(("valves.lamp", True), ("valves.speed", -1), made_at=NOW) == [
        known, "valves.speed takes u8, not -1"
    ]  # fmt: skip
    now = run.now()
    others = (
        ("valves.lamp", False),
        ("valves.speed", "x"),
        ("valves.speed", 8),
        ("valves.lamp", True),
        ("hoist.start", 1),
    )
    changed = "the configuration of the bus has changed meanwhile"
    reasons = ["", "valves.speed takes u8, not 'x'", "", known, "hoist.start takes true, not 1"]
    assert await given(*others, made_at=now) == reasons
    assert await given(("valves.lamp", True), ("hoist.start", True), made_at=now + 1) == ["", changed]
    assert run.carried[1:] == [SetOutputs(8, {"lamp": False, "speed": 8}), SetOutputs(8, {"lamp": True})]
    # the run takes all of them or none, and each is told
    outside = "valves: speed = 200 is outside 0..100"
    assert await given(("valves.lamp", True), ("valves.speed", 200), made_at=run.now()) == [outside, outside]
    late = asyncio.ensure_future(given(("valves.lamp", True), ("valves.speed", 9), made_at=run.now() - 1.5))
    assert len(run.carried) == 3
    assert await run.reason("valves.lamp", True) == ""
    assert run.carried[3:] == [SetOutputs(8, {"lamp": True})]
    assert ["s old by the clock" in one for one in await late] == [True, True]


@in_virtual_time
async def test_a_stop_waits_for_nobody_and_nothing_that_waits_comes_after_it() -> None:
    run = Run("hoist.*", "valves.*", seconds=5.0)
    start = asyncio.ensure_future(run.reason("hoist.start"))
    await asyncio.sleep(0.1)
    speed = asyncio.ensure_future(run.reason("hoist.speed", 1.0))
    lamp = asyncio.ensure_future(run.reason("valves.lamp", True))
    await asyncio.sleep(0.1)
    stop = asyncio.ensure_future(run.reason("hoist.stop"))
    await asyncio.sleep(0.1)
    assert run.at_once == 3
    assert [await one for one in (start, speed, lamp, stop)] == [
        "",
        "a later order has stopped the drive meanwhile",
        "",
        "",
    ]
    assert run.carried == [DriveOrder(3, "start"), SetOutputs(8, {"lamp": True}), DriveOrder(3, "stop")]


@in_virtual_time
async def test_orders_of_one_message_age_from_its_coming_and_end_by_a_stop_of_another() -> None:
    run = Run("hoist.*", "valves.*", seconds=1.0)
    batch = run.orders.batch()

    async def reason(name: str, value: object = None) -> str:
        return (await run.orders.give(name, value, made_at=None, late_s=0.5, batch=batch)).reason

    assert [await reason("valves.speed", number) for number in (1, 2, 3)] == [
        "",
        "",
        "it has been on its way for 2.5 s; 2 s are allowed",
    ]
    batch = run.orders.batch()
    assert await reason("hoist.stop") == ""
    assert await reason("hoist.start") == ""  # behind a stop of its own message
    batch = run.orders.batch()
    assert await run.reason("hoist.stop") == ""
    assert await reason("hoist.start") == "a later order has stopped the drive meanwhile"
    assert run.carried[2:] == [DriveOrder(3, "stop"), DriveOrder(3, "start"), DriveOrder(3, "stop")]


@in_virtual_time
async def test_orders_that_wait_are_bounded_and_one_slave_holds_up_no_other() -> None:
    run = Run("hoist.*", "valves.*", seconds=3600.0)
    given = [asyncio.ensure_future(run.reason("valves.speed", number)) for number in range(100)]
    await asyncio.sleep(0)
    refused = [one.result() for one in given if one.done()]
    assert refused == ["too many orders to this slave wait"] * (100 - MOST_OF_A_SLAVE)
    assert len(run.refused) == 100 - MOST_OF_A_SLAVE
    await asyncio.sleep(1)
    stopping = asyncio.ensure_future(run.reason("hoist.stop"))
    await asyncio.sleep(0)
    assert not stopping.done()
    begun = run.now()
    results = [await one for one in given[:MOST_OF_A_SLAVE]]
    assert results[0] == "no result after 90 s"
    assert run.now() - begun == pytest.approx(90 * MOST_OF_A_SLAVE, rel=0.01)
    assert run.at_once == 0


@in_virtual_time
async def test_an_order_whose_sender_has_gone_is_taken_back() -> None:
    run = Run("valves.*", seconds=5.0)
    given = [asyncio.ensure_future(run.reason("valves.speed", number)) for number in range(3)]
    await asyncio.sleep(1)
    given[0].cancel()
    given[1].cancel()
    assert await given[2] == ""
    assert run.carried == [SetOutputs(8, {"speed": 2})]


@in_virtual_time
async def test_a_stop_whose_sender_has_gone_is_carried_out() -> None:
    run = Run("hoist.*", seconds=5.0)
    for order in ("hoist.start", "hoist.stop"):
        given = asyncio.ensure_future(run.reason(order))
        await asyncio.sleep(1)
        given.cancel()
        with pytest.raises(asyncio.CancelledError):
            await given
    await asyncio.sleep(5)
    assert run.carried == [DriveOrder(3, "stop")]


@in_virtual_time
async def test_an_absent_slave_gets_no_order_but_a_stop() -> None:
    """Outputs would change when it is back, whenever that is; a drive that has got no stop would go on then."""
    run = Run("hoist.*", "valves.*", seconds=1.0)
    why = "the slave is not in data exchange"
    first, second = (asyncio.ensure_future(run.reason("valves.lamp", on)) for on in (True, False))
    await asyncio.sleep(0.5)
    run.tree.apply(snapshot("3", "8"), 0.0)
    assert [await first, await second] == ["", why]
    assert await run.reason("hoist.start") == why
    [result] = await run.orders.give_outputs([("valves.lamp", True)], made_at=None)
    assert (result.reason, result.kind) == (why, Refusal.NO_EXCHANGE)
    for word in ("stop", "quick_stop", "coast"):
        assert await run.reason(f"hoist.{word}") == ""
    halts = [DriveOrder(3, word) for word in ("stop", "quick_stop", "coast")]
    assert run.carried == [SetOutputs(8, {"lamp": True}), *halts]


@in_virtual_time
async def test_a_configuration_that_changes_meanwhile_is_judged_again() -> None:
    """While the order waits, the slaves exchange their names."""
    run = Run("valves.lamp", seconds=1.0)
    first = asyncio.ensure_future(run.reason("valves.lamp", True))
    second = asyncio.ensure_future(run.reason("valves.lamp", False))
    await asyncio.sleep(0.5)
    changed = plant(names=("valves", "hoist"))
    lamp = {"name": "lamp", "type": "bool", "at": "bool@0.0"}
    changed["plant"]["slaves"]["3"] = {"name": "valves", "outputs": [lamp]}
    run.tree.apply(changed, 1.0)
    assert await first == ""
    assert await second == "the configuration of the bus has changed meanwhile"
    assert run.carried == [SetOutputs(8, {"lamp": True})]


@in_virtual_time
async def test_a_connector_that_knows_an_earlier_plant_gives_no_order() -> None:
    """OPC UA checks the type by the order of its node; meanwhile the output of that name may have another type."""
    run = Run("valves.*")
    known = run.tree.orders["valves.speed"]
    assert (await run.orders.give(known, 7, made_at=None)).reason == ""
    for earlier in (dataclasses.replace(known, type="u16"), dataclasses.replace(known, slave=3)):
        results = [await run.orders.give(earlier, 7, made_at=None)]
        results += await run.orders.give_outputs([(earlier, 7), (known, 8)], made_at=None)
        changed = "the configuration of the bus has changed meanwhile"
        assert [one.reason for one in results] == [changed, changed, ""]
    assert run.carried == [SetOutputs(8, {"speed": value}) for value in (7, 8, 8)]


@in_virtual_time
async def test_a_run_that_only_reads_refuses_all() -> None:
    run = Run("valves.*", "hoist.*", read_only=True)
    for name, value in (("valves.lamp", True), ("hoist.stop", None), ("nobody.there", 1)):
        assert await run.reason(name, value) == "this run is read only: it takes no orders"
    run.orders = Orders(PlantTree(), run.carry_out, ["valves.*"])
    assert await run.reason("valves.lamp", True) == "the bus is not known yet"
    assert run.carried == []


@in_virtual_time
async def test_each_order_is_told_and_each_refused_one_with_its_origin_and_time() -> None:
    run = Run("valves.lamp")
    why = "it is not in allow_commands"
    await run.reason("valves.lamp", True)
    await run.orders.give("valves.speed", 1, made_at=NOW)
    await run.orders.give("valves.speed", 1, made_at=NOW, order_time="2023-11-14T23:13:20+01:00", by="anna")
    await run.orders.give_outputs([("valves.lamp", True), ("valves.speed", 1)], made_at=float("inf"))
    await run.orders.give("valves.speed", 1, made_at=None)
    run.orders.refuse("Outputs/nothing", "there is no such metric")
    assert run.told == [("order valves.lamp: done", Severity.INFO)]
    old = "its time is inf s ahead of the clock of this computer: set the clocks"
    assert run.refused == [
        RefusedOrder("valves.speed", why, "mqtt", "2023-11-14T22:13:20.000Z"),
        RefusedOrder("valves.speed", why, "mqtt (anna)", "2023-11-14T23:13:20+01:00"),
        RefusedOrder("valves.lamp", old, "mqtt", "inf"),
        RefusedOrder("valves.speed", why, "mqtt", "inf"),
        RefusedOrder("valves.speed", why, "mqtt"),
        RefusedOrder("Outputs/nothing", "there is no such metric", "mqtt"),
    ]


def test_patterns_that_fit_nothing_are_errors_of_the_configuration() -> None:
    orders = ["valves.lamp", "valves.speed", "hoist.start", "lift.2.start"]
    check_allowed(["valves.lamp", "hoist.*", "lift.2.*"], orders)
    for pattern, hint in {
        "valves.lmap": "did you mean 'valves.lamp'?",
        "valve.*": "did you mean 'valves.*'?",
        "*": "write SLAVE.OUTPUT, SLAVE.start for a drive, or SLAVE.*",
        "lift.*": "did you mean 'lift.2.*'?",
        "\x1b[2J": "write SLAVE.OUTPUT, SLAVE.start for a drive, or SLAVE.*",
    }.items():
        with pytest.raises(ConfigError) as caught:
            check_allowed([pattern], orders)
        assert str(caught.value).endswith(f"fits no order of this plant; {hint}")
        assert str(caught.value).isprintable()
    assert is_allowed(["lift.2.*"], "lift.2.start")
    assert not is_allowed(["lift.*"], "lift.2.start")
    assert not is_allowed([".*"], "start")


@in_virtual_time
async def test_orders_of_before_the_clock_was_set_back_take_no_room(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dpstack.bridge.orders._MOST_KNOWN", 3)
    run = Run("valves.*")
    for made_at in (NOW, NOW + 0.1, NOW + 0.2):
        assert await run.reason("valves.lamp", True, made_at=made_at) == ""
    assert await run.reason("valves.lamp", True, made_at=NOW + 0.3) == "too many orders have come"
    run.begun += 3600  # the clock goes back
    assert await run.reason("valves.lamp", True, made_at=NOW - 3600) == ""
    assert "given already" in await run.reason("valves.lamp", True, made_at=NOW - 3600)
    assert "ahead of the clock" in await run.reason("valves.lamp", True, made_at=NOW)
