"""The simulated I/O station on a bus: by its GSD file's name, told what happens by the commands of ``dpstack ctl``."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncIterator, Callable

import pytest
from api_kit import RAW, bench_of, operating
from support import instance, present

import dpstack
from dpstack import Im0
from dpstack.api.config.config import slave_config
from dpstack.api.control.commands import KINDS, find
from dpstack.api.control.handlers import run_status
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave_side.virtual_bench import SimulatedSlave
from dpstack.cli.commands import ctl
from dpstack.errors import UsageError
from dpstack.params import BusParams

pytestmark = pytest.mark.virtual_time

IO: dict[str, object] = {
    "name": "io",
    "address": 8,
    "gsd": "io-station",
    "modules": ["8 DI", "8 DO", "2 AI"],
    "inputs": {"level": "i16@1"},
    "dpv1": {"alarms": []},
}


@contextlib.asynccontextmanager
async def station(io: dict[str, object] = IO) -> AsyncIterator[tuple[dpstack.Bus, Callable[[str], object]]]:
    """A bus with the I/O station, and the orders of ``dpstack ctl`` to it."""
    async with operating(io, RAW) as bus:
        handlers = slave_handlers(bench_of(bus))

        def order(text: str) -> object:
            name, *args = text.split()
            return handlers[name](args)

        yield bus, order


async def settled(bus: dpstack.Bus) -> dpstack.Slave:
    await bus.rotated(bus.stats.rotations + 5)
    return bus.slave("io")


def ext(slave: dpstack.Slave) -> str:
    return present(slave.diagnosis).ext.hex(" ").upper()


async def test_faults_of_the_station_reach_the_master() -> None:
    async with station() as (bus, order):
        left_out = "done, without an alarm: slave io: process alarm, slot 1: its master did not enable process alarms"
        assert order("input io 1 05") == (f'{left_out} in Set_Prm; add "process" to alarms of [slave.dpv1] there')
        assert order("input 8 3 01020304") is None
        slave = await settled(bus)
        assert slave.inputs.hex() == "0501020304"
        order("wire-break io 3 0 on")
        slave = await settled(bus)
        assert slave.inputs.hex() == "057fff0304"
        assert ext(slave) == "05 82 00 00 10 42 04 82 40 A6"
        order("wire-break io 3 0 off")
        order("pull io 1")
        slave = await settled(bus)
        assert slave.inputs.hex() == "0001020304"
        order("plug io 1 16DO")
        slave = await settled(bus)
        assert ext(slave).endswith("42 01")
        order("pull io 1")
        order("plug io 1")
        order("parameter io 1 02")
        slave = await settled(bus)
        assert await slave.read(1, 1) == b"\x02"
        im = instance(await slave.im(slot=2), Im0)
        assert im.order_id == "8 DO"
        await slave.write(3, 1, b"\x00")
        assert await slave.read(3, 1) == b"\x00"


@pytest.mark.parametrize("mode", [0, 3])
async def test_its_alarms_reach_the_program_in_order_and_are_acknowledged(mode: int) -> None:
    table = IO | {"dpv1": {"alarms": ["pull_plug", "process", "diagnostic", "update"], "alarm_mode": mode}}
    async with station(table) as (bus, order):
        stream, messages = bus.slave("io").alarms(), bus.slave("io").status_messages()
        for text in (
            "input io 1 05",
            "input io 1 0F",
            "wire-break io 3 1 on",
            "pull io 2",
            "plug io 2 8DI",
            "pull io 2",
            "plug io 2",
            "wire-break io 3 1 off",
            "parameter io 1 02",
        ):
            assert order(text) is None
        found = [await anext(stream) for _ in range(9)]
        seen = [f"{alarm.type} {alarm.slot} {alarm.specifier.value} {alarm.data.hex()}" for alarm in found]
        wanted = ["2 1 0 0505", "2 1 0 0a0f", "1 3 1 0106", "3 2 1 20", "4 2 3 10", "3 2 1 10", "4 2 2 20"]
        wanted += ["1 3 2 0106", "6 1 0 02"]
        if mode:
            assert seen == wanted
        assert sorted(seen) == sorted(wanted)
        for kind in "123467":  # those of one type keep their order
            assert [one for one in seen if one[0] == kind] == [one for one in wanted if one[0] == kind]
        slots = [(await anext(messages)).text for _ in range(6)]
        assert slots[0] == "module status: slot 3 data invalid"
        assert slots[2] == "module status: slot 2 wrong module, slot 3 data invalid"
        assert slots[5] == "module status: all modules ok"
        await settled(bus)
        counts = present(bus.slave("io").alarm_counts)
        assert (counts.raised, counts.acknowledged, counts.repeated, counts.too_many) == (9, 9, 0, 0)
        device = bench_of(bus).device(8)
        assert present(device.alarm_server).pending == ()


async def test_status_shows_its_slots(capsys: pytest.CaptureFixture[str]) -> None:
    async with station() as (bus, order):
        bus.slave("io").outputs = b"\xa5"
        for text in ("input io 1 05", "pull io 1", "wire-break io 3 1 on"):
            order(text)
        await settled(bus)
        status = run_status(bus)["slaves"]
        assert isinstance(status, dict)
        assert "slots" not in status["9"]
        assert status["8"]["slots"] == {
            "1": {"module": "8 DI", "plugged": None, "state": "no module", "inputs": "00", "parameter": "01"},
            "2": {"module": "8 DO", "plugged": "8 DO", "state": "ok", "outputs": "a5"},
            "3": {
                "module": "2 AI",
                "plugged": "2 AI",
                "state": "data invalid",
                "inputs": "00007fff",
                "parameter": "01",
                "wire_breaks": [1],
            },
        }
        ctl._show({"slots": status["8"]["slots"]})
        assert capsys.readouterr().out == (
            "slots:\n"
            "  1: module 8 DI, plugged none, state no module, inputs 00, parameter 01\n"
            "  2: module 8 DO, plugged 8 DO, state ok, outputs a5\n"
            "  3: module 2 AI, plugged 2 AI, state data invalid, inputs 00007fff, parameter 01, wire_breaks 1\n"
        )


async def test_switched_off_it_keeps_what_is_plugged() -> None:
    async with station() as (bus, order):
        order("pull io 2")
        order("power-off io")
        await bus.until(lambda: not bus.slave("io").ready_now, 5)
        order("power-on io")
        await bus.slave("io").ready(5)
        assert ext(await settled(bus)).endswith("42 02")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("pull raw 1", 'slave 9 (raw) is no I/O station; one has gsd = "io-station"'),
        ("trip io F1", "slave 8 (io) is no simulated drive: the I/O station"),
        ("pull io one", "'one' is no whole number"),
        ("pull io 4", "there is no module in slot 4; there are: slot 1 (8 DI), slot 2 (8 DO), slot 3 (2 AI)"),
        ("plug io 1", "slot 1 (8 DI): a module is plugged; pull it first"),
        ("input io 1 5", "write for instance 01"),
        ("input io 1 0505", "slot 1 (8 DI) has 1 octets of inputs, 2 were given"),
        ("wire-break io 3 0 yes", "'yes' is neither on nor off"),
        ("wire-break io 1 0 on", "slot 1 (8 DI) has no analogue input channel 0"),
        ("parameter io 1 0102", "'0102' is not one octet"),
        ("parameter io 1 80", "bits 80 have no meaning"),
    ],
)
async def test_orders_that_cannot_be(text: str, says: str) -> None:
    async with station() as (_, order):
        name, *args = text.split()
        find("sim", KINDS["sim"], name).check(args)
        with pytest.raises((UsageError, ValueError)) as caught:
            order(text)
        assert says in str(caught.value)


def test_the_simulation_names_the_kind_of_a_slave() -> None:
    params = BusParams.preset(500_000)
    kinds = [SimulatedSlave(slave_config(table), params).kind for table in (IO, RAW)]
    assert kinds == ["io-station", "mirror"]
