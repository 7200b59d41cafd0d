"""``slave.hart`` on a bus: over MS1 and a class 2 connection, through the control socket's order, with every error."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest
from api_kit import bench_of, bus_of, off_and_on
from support import instance

import dpstack
from dpstack import HartError, IoStation, UsageError
from dpstack.api.control.record_orders import carry_out, parse_order
from dpstack.api.control.simulation_handlers import slave_handlers

pytestmark = pytest.mark.virtual_time
IO: dict[str, object] = {"name": "io", "address": 8, "gsd": "io-station", "modules": ["8 DI", "2 AI HART"]}


def bus() -> dpstack.Bus:
    """A slow cycle: virtual seconds cost little."""
    return bus_of(IO, cycle_ms=20.0)


async def order(slave: dpstack.Slave, *texts: str) -> dict[str, Any]:
    return await carry_out(slave, parse_order("hart", texts))


async def test_over_both_classes_of_masters() -> None:
    async with bus() as found:
        await found.ready()
        io = found.slave("io")
        device = io.hart(0, slot=2)
        reading = await device.read()
        assert reading.identity.device_id == 0x010203
        assert reading.device_status == ("cold start",)
        assert reading.tag is not None
        assert (reading.tag.tag, reading.long_tag) == ("PT-101", "PT-101")
        async with found.class2.connect("io") as connection:
            other = connection.hart(1, slot=2, compact=True)
            answers = await asyncio.gather(device.command(3), other.command(3))
        assert [one.data[4] for one in answers] == [7, 32]
        assert device.counters.requests >= 7
        module = await other.module()
        assert (module.directory.channels, module.features.compact) == (2, True)


async def test_the_order_of_the_command_line() -> None:
    async with bus() as found:
        await found.ready()
        io = found.slave("io")
        answer = await order(io, "1-2", "1", "transparent", "3")
        assert (answer["slot"], answer["channel"], answer["command"]) == (2, 1, 3)
        assert answer["rows"] == [("loop current", "8 mA"), ("PV", "0 °C"), ("device status", "good")]
        with pytest.raises(HartError, match=r"^slave 8 \(io\): slot 2 has the HART channels 0 to 1, no channel 2$"):
            await order(io, "1-2", "2")
        with pytest.raises(
            HartError, match=r"^slave 8 \(io\): slot 1 has no HART module \(record 148: invalid index\)$"
        ):
            await order(io, "1", "0")
        with pytest.raises(HartError, match="none of its slots 3 to 4 has a HART module"):
            await order(io, "3-4", "0")


async def test_all_channels_when_one_has_no_device() -> None:
    async with bus() as found:
        await found.ready()
        instance(bench_of(found).device(8), IoStation).wire_break(2, 0, True)
        steps: list[tuple[str, int, int]] = []
        answer = await carry_out(
            found.slave("io"), parse_order("hart", ("1-2", "all")), lambda *step: steps.append(step)
        )
        assert steps == [("channels", 0, 2), ("channels", 1, 2)]
        assert [one.get("error", one.get("tag")) for one in answer["channels"]] == [
            "channel fault: open line: check wire and supply of the transmitter",
            "TT-102",
        ]


async def test_faults_and_power() -> None:
    async with bus() as found:
        await found.ready()
        io = found.slave("io")
        bench = bench_of(found)
        station = instance(bench.device(8), IoStation)
        ctl = slave_handlers(bench)["hart"]
        ctl(["io", "2", "0", "busy", "1"])
        ctl(["io", "2", "1", "status", "90"])
        device = io.hart(0, slot=2)
        assert (await device.command(1)).data[0] == 7
        assert device.counters.busy == 1
        ctl(["io", "2", "0", "silent"])
        assert station.injected == ("hart 2 0 silent",)
        with pytest.raises(HartError, match="no answer in time, tried 3 times") as raised:
            await device.command(1)
        assert (raised.value.reason, raised.value.address, raised.value.response_code) == ("module", 8, None)
        ctl(["io", "2", "0", "well"])
        station.wire_break(2, 0, True)
        with pytest.raises(HartError, match="open line"):
            await device.command(1)
        station.wire_break(2, 0, False)
        await off_and_on(found, 8)
        answer = await io.hart(1, slot=2).command(1)
        assert answer.device_status_texts[0] == "device malfunction"
        with pytest.raises(ValueError, match="no HART channels"):
            ctl(["io", "1", "0", "busy"])


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"channel": -1}, "HART channels count from 0"),
        ({"channel": "0"}, "channel = '0' is no whole number"),
        ({"channel": 0, "timeout": "1"}, "timeout"),
    ],
)
async def test_wrong_channels(keys: dict[str, Any], text: str) -> None:
    async with bus() as found:
        with pytest.raises(UsageError, match=text):
            found.slave("io").hart(**keys)


@pytest.mark.parametrize(
    ("number", "data", "text"),
    [
        (256, b"", "extended commands are data of command 31"),
        (1, "00", "is no octets"),
        (1, bytes(256), "255 are possible"),
    ],
)
async def test_wrong_commands(number: int, data: Any, text: str) -> None:
    async with bus() as found:
        device = found.slave("io").hart(0, slot=2)
        with pytest.raises(UsageError, match=text):
            await device.command(number, data)


@pytest.mark.parametrize(
    ("texts", "text"),
    [
        (("2",), "hart takes SLOTS CHANNEL"),
        (("4-2", "0"), "write slots as 2, or 1-4"),
        (("2", "x"), "'x' is no CHANNEL"),
        (("2", "0", "short"), "'short' is no HART format: transparent or compact"),
        (("2", "0", "compact", "256"), "'256' is no COMMAND"),
        (("2", "0", "compact", "3", "0G"), "no hex digit"),
    ],
)
def test_wrong_orders(texts: tuple[str, ...], text: str) -> None:
    with pytest.raises(UsageError, match=text):
        parse_order("hart", texts)
