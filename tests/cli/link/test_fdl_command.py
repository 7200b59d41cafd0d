"""``dpstack fdl`` in virtual time: its one line for each outcome, JSON, exit codes, wrong use."""

from __future__ import annotations

import asyncio
import functools
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from cli_kit import Cli

import dpstack
from dpstack.api.bus.virtual import run_virtual
from dpstack.api.control.handlers import control_run
from dpstack.api.control.remote import fdl_through_run
from dpstack.api.fdl.orders import FdlOrder, parse_fdl_order
from dpstack.cli.link import station
from dpstack.fdl import FdlError, FdlStation, Ident

BUS = ("--baud", "187500", "--address", "1")


@asynccontextmanager
async def partner(world: dpstack.World) -> AsyncIterator[list[str]]:
    """Controller 5 with the SAPs 20 and 21, which have reply data."""
    told: list[str] = []
    ident = Ident("maker \x1b[31m", "gateway", "1", "2.0")
    async with dpstack.open_fdl(world=world, baud=187_500, address=5, hsa=6, ident=ident) as fdl:
        sap = await fdl.sap(20, on_receive=lambda indication: told.append(indication.text))
        await sap.update(b"\x11\x22")
        urgent = await fdl.sap(21)
        await urgent.update(b"\x33", high=True)
        yield told


@pytest.fixture
def fdl(monkeypatch: pytest.MonkeyPatch, cli: Cli) -> Cli:
    """The command beside that controller; what that has got is printed before the outcome."""
    world: dpstack.World

    def run(program: Any) -> Any:
        nonlocal world
        world = dpstack.World()
        monkeypatch.setattr(station, "FdlStation", functools.partial(FdlStation, world=world))

        async def beside() -> Any:
            async with partner(world) as told:
                try:
                    return await program
                finally:
                    await asyncio.sleep(0.01)
                    for text in told:
                        print(f"partner: {text}")

        return run_virtual(beside())

    monkeypatch.setattr("asyncio.run", run)
    return cli.of("fdl", "/dev/null")


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ("status 5", "station 5: master in ring"),
        ("ident 5", "station 5: vendor 'maker \\x1b[31m', controller 'gateway', hardware '1', software '2.0'"),
        ("srd 5 0102 --dsap 20 --ssap 0x08", "SRD to station 5, SAP 20: DL, reply data, low priority: 11 22"),
        ("srd 5 --dsap 21 --high", "SRD to station 5, SAP 21: DH, reply data, high priority: 33"),
        ("sda 5 01 --dsap 20", "SDA to station 5, SAP 20: OK, 1 octet taken"),
        ("sdn 127 0102 --dsap 20 --yes", "SDN to all stations, SAP 20: 2 octets sent, without acknowledgement"),
    ],
)
def test_one_line(words: str, line: str, fdl: Cli) -> None:
    assert fdl.out(*words.split(), *BUS).splitlines()[-1] == line


def test_the_other_end_has_it(fdl: Cli) -> None:
    assert "partner: SDA of station 1 to SAP 20: AA BB" in fdl.out("sda", "5", "AA BB", "--dsap", "20", *BUS)


@pytest.mark.parametrize(
    ("words", "status"),
    [
        ("sda 5 01", "RS"),
        ("srd 5 01 --dsap 22", "RS"),
        ("status 4", "NA"),
        ("lsap 5 --dsap 20", "RS"),
        ("msrd 5 01", "RS"),
        ("sda 127 01 --yes", "IV"),
    ],
)
def test_not_positive_ends_with_1(words: str, status: str, fdl: Cli) -> None:
    assert f": {status}, " in fdl.err(*words.split(), *BUS, code=1)
    assert fdl.json(*words.split(), *BUS, code=1)["status"] == status


def test_json(fdl: Cli) -> None:
    lines = fdl.out("srd", "5", "01", "--dsap", "20", *BUS, "--json").splitlines()
    assert lines[-1] == (
        '{"service":"srd","address":5,"dsap":20,"ssap":null,"status":"DL","data":"1122",'
        '"text":"SRD to station 5, SAP 20: DL, reply data, low priority: 11 22","through":"station"}'
    )


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("srd 5 01 --dsap 61", "--dsap 61: DP parameterises and commands slaves by it: add --yes"),
        ("srd 5 01 --ssap 62", "--ssap 62: DP"),
        ("sdn 127 01", "address 127 is all stations, and slaves act on such telegrams: add --yes"),
        ("status 5 01", "status sends no data: leave 01 out"),
        ("status 5 --dsap 3", "status goes to no SAP"),
        ("lsap 5", "lsap asks for one SAP of the station"),
        ("sda 128 01", "is no station address"),
        ("sda 5 01 --dsap 64", "is no SAP"),
        ("sda 5 0G", "is no hex"),
        ("abc 5", "invalid choice"),
    ],
)
def test_wrong_use(words: str, says: str, fdl: Cli) -> None:
    assert says in fdl.err(*words.split(), *BUS)


SLAVE: dict[str, Any] = {"name": "a", "address": 7, "ident": 0x1234, "config": "23 13"}


@pytest.mark.virtual_time
async def test_through_the_run_that_holds_the_port() -> None:
    world = dpstack.World()
    dpstack.simulate(world, [SLAVE], baud=187_500)

    async def asked(words: str) -> dict[str, Any] | None:
        return await fdl_through_run("/dev/plant", words.split())

    bus = dpstack.open_bus(world=world, port="/dev/plant", baud=187_500, slaves=[SLAVE], hsa=8)
    async with bus, partner(world) as told, control_run(bus, "/dev/plant"):
        await bus.operate()
        await bus.ready()
        assert await asked("status 5") == {
            "status": "OK",
            "type": "master_in_ring",
            "text": "station 5: master in ring",
        }
        answer = await asked("srd 5 0102 dsap=20 ssap=8")
        assert answer == {"status": "DL", "data": "1122", "text": answer and answer["text"]}
        found = await asked("ident 5")
        assert found is not None
        assert (
            found["text"] == "station 5: vendor 'maker \\x1b[31m', controller 'gateway', hardware '1', software '2.0'"
        )
        with pytest.raises(FdlError) as error:
            await asked("sda 5 01 dsap=22")
        assert (error.value.status, error.value.address) == ("RS", 5)
        for words, says in (
            ("srd 7 01", "the default SAP of its slave is Data_Exchange"),
            ("sdn 127 01 dsap=20", "a telegram to all stations"),
            ("srd 5 01 dsap=61", "SAPs 48 to 63 are those of DP"),
            ("srd 5 01 sap=3", "'sap=3': write dsap=20"),
            ("srd 5 0G", "'0G' is no hex"),
            ("srd 5 01 dsap=64", "'64' is no SAP"),
            ("srd 128", "'128' is no station address"),
            ("abc 5", "'abc' is no service"),
            ("status 5 01", "status sends no data"),
        ):
            with pytest.raises(dpstack.UsageError, match=says):
                await asked(words)
        assert bus.slave("a").ready_now
        assert told == ["SRD of station 2 to SAP 20: 01 02"]
    assert await asked("status 5") is None


def test_words_are_read_as_they_were_written() -> None:
    for order in (
        FdlOrder("sda", 127, b"\x01\xff", 63, 0, True),
        FdlOrder("status", 0),
        FdlOrder("lsap", 126, dsap=62),
        FdlOrder("srd", 5),
    ):
        assert parse_fdl_order(order.words) == order


def test_a_port_without_stations(cli: Cli) -> None:
    assert 'nobody is on port "virtual"' in cli.err("fdl", "virtual", "status", "5", *BUS)
