"""``dpstack ppi``: what is wrong is said before the port is opened."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

import dpstack
from dpstack.api.control.handlers import control_run
from dpstack.api.control.remote import ppi_through_run
from dpstack.api.ppi.orders import parse_ppi_order, ppi_order
from dpstack.cli.link import ppi
from dpstack.cli.main import main
from dpstack.errors import CpuRefused, DpError, PortBusyError, SlaveTimeout, UsageError
from dpstack.fdl.passive.station import PassiveStation
from dpstack.params import BusParams
from dpstack.ppi import CpuStation

PORT = "/nowhere/port"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["read"], "read needs addresses"),
        (["read", "DB1.DBW0"], "no address of an S7-200"),
        (["write", "VW0"], "write needs an address and a value"),
        (["write", "VW0", "x", "--yes"], "VW0: 'x' is no value; a number is wanted"),
        (["write", "VW0", "70000", "--yes"], "0 to 65535"),
        (["write", "M0.0", "2", "--yes"], "0 or 1 is wanted"),
        (["write", "VB0[2]", "0x", "--yes"], "octets in hex"),
        (["write", "VW0", "1"], "add --yes if that is meant"),
        (["stop"], "stop acts on the plant of CPU 2: add --yes"),
        (["clock", "now"], "clock takes no 'now': leave it out"),
        (["set-time", "a", "b", "--yes"], "set-time takes one time"),
    ],
)
def test_wrong_words(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ppi", PORT, "2", *words]) == 2
    assert message in capsys.readouterr().err


def test_a_port_that_is_not_there(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["ppi", PORT, "2", "read", "VW0"]) != 0
    assert PORT in capsys.readouterr().err


@pytest.mark.parametrize(
    ("error", "words", "message"),
    [
        (PortBusyError("held by `minicom` (pid 1): end it"), [], "dpstack: held by `minicom` (pid 1): end it\n"),
        (SlaveTimeout(2, "no answer: check the rate"), [], "check the rate (asked at 9.6 kbit/s: --baud)\n"),
        (SlaveTimeout(2, "no answer: check the rate"), ["--baud", "187500"], "(asked at 187.5 kbit/s: --baud)\n"),
    ],
)
def test_the_next_step(
    error: DpError, words: list[str], message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def station_for(_: object) -> None:
        raise error

    monkeypatch.setattr(ppi, "station_for", station_for)
    assert main(["ppi", PORT, "2", "read", "VW0", *words]) == 1
    assert capsys.readouterr().err.endswith(message)


# --- through a run ----------------------------------------------------------------------------------------------------
PRESS: dict[str, Any] = {
    "address": 2,
    "name": "press",
    "values": {"level": "VW100", "on": "M0.3"},
    "allow_commands": ["on"],
    "poll_ms": 3_600_000,
}
SLAVE: dict[str, Any] = {"name": "a", "address": 7, "ident": 0x1234, "config": "23 13"}


@pytest.mark.parametrize(
    ("action", "words"),
    [
        ("read", ["VW100", "VD8:real", "M0.3"]),
        ("write", ["VB0[2]", "01FF"]),
        ("set-time", ["2026-11-28T12:00"]),
        ("set-time", []),
        ("stop", []),
    ],
)
def test_an_order_says_the_same_on_the_socket(action: str, words: list[str]) -> None:
    order = ppi_order(action, 2, words)
    assert parse_ppi_order(order.control_words) == order


@pytest.mark.parametrize("words", ["126 read VW0", "x clock", "2 format", "2 stop now"])
def test_wrong_words_on_the_socket(words: str) -> None:
    with pytest.raises(UsageError):
        parse_ppi_order(words.split())


async def _asked(words: str) -> Any:
    found = await ppi_through_run("/dev/plant", words.split())
    assert found is not None
    return [line["text"] for line in found]


@pytest.mark.virtual_time
async def test_the_run_that_holds_the_port_asks() -> None:
    world = dpstack.World()
    dpstack.simulate(world, [SLAVE], baud=187_500)
    for address in (2, 4):
        params = BusParams.preset(187_500, address=address)
        world.add(PassiveStation(address, CpuStation(), params), name=f"CPU {address}")
    bus = dpstack.open_bus(world=world, port="/dev/plant", baud=187_500, slaves=[SLAVE], ppi=[PRESS], hsa=8)
    async with bus, control_run(bus, "/dev/plant"):
        await bus.operate()
        await bus.ready()
        assert await _asked("2 read VW100 M0.3") == ["VW100: 0", "M0.3: 0"]
        polls = bus.cpu("press").polls
        assert await _asked("2 write M0.3 on") == ["M0.3: 1, written"]
        await asyncio.sleep(1)  # an hour would pass till the next poll
        assert (bus.cpu("press").polls, bus.cpu("press")["on"]) == (polls + 1, True)
        refusals = {
            "2 write VW100 5": r"CPU 2 \(press\): VW100 is not written for others by this run, .* allows: M0.3; name",
            "2 stop": r"CPU 2 \(press\) belongs to the plant of this run, .*: for stop end the run first",
            "7 read VW0": "slave",
        }
        for words, why in refusals.items():
            with pytest.raises(UsageError, match=why):
                await _asked(words)
        # a CPU that is not in the plant file
        assert await _asked("4 write VW100 250") == ["VW100: 250, written"]
        assert await _asked("4 read VW100") == ["VW100: 250"]
        assert await _asked("4 stop") == ["CPU 4 is in STOP"]
        assert (await _asked("4 set-time 2026-11-28T12:00")) == ["CPU 4: set to 2026-11-28 12:00:00"]
        with pytest.raises(CpuRefused, match="CPU 4 refuses read VB99999"):
            await _asked("4 read VB99999")
        with pytest.raises(SlaveTimeout):
            await _asked("6 read VW0")
