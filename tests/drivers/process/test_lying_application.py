"""A bus process whose application sends what cannot be ends the bus in order, with safe outputs."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Iterator

import pytest

from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import SlaveState
from dpstack.dpv1.master.ms1 import Ms1
from dpstack.dpv1.master.orders import RecordOrder
from dpstack.dpv1.pdu.read_write import Function
from dpstack.errors import UsageError
from tests.fuzz.targets import process_server
from tests.fuzz.targets.process_server import GIVEN, MS, SAFE


@pytest.fixture
def run() -> Iterator[process_server.Run]:
    """The bus process in virtual time, with two slaves in data exchange in Operate, whose outputs are ``GIVEN``."""
    one = process_server.Run(b"\x0d")
    with process_server.patched(one):
        host = one.begin()
        one.ask("GoOnline")
        one.ask("SetMode", mode=Mode.OPERATE)
        one.run(130 * MS)
        one.write_outputs(0x0C)
        one.run(40 * MS)
        assert all(handler.state is SlaveState.DATA_EXCHANGE for handler in host._master.handlers.values())
        assert [slave.outputs for slave in one.runtime.slaves.values()] == [GIVEN, GIVEN]
        yield one
    one.close()


def put_picture(one: process_server.Run) -> None:
    """Outputs as a number, with the right check sum."""
    area = one.image.outputs
    number = area._words[0] + 1
    place = number % 4
    area._words[1 + 2 * place], area._words[2 + 2 * place] = 1, zlib.crc32(b"\x07", number)
    area._memory[area._at + place * area._limit] = 7
    area._words[0] = number


LIES: dict[str, Callable[[process_server.Run], object]] = {
    "no question": lambda one: one.put(b"\0\0\0\4null"),
    "a number below 0": lambda one: one.put(b'\0\0\0\x24{"number":-1,"order":["GoOnline",{}]}'[:40]),
    "a picture of another kind": put_picture,
}


@pytest.mark.parametrize("lie", LIES)
def test_the_bus_ends_in_order(run: process_server.Run, lie: str) -> None:
    LIES[lie](run)
    run.run(1_000 * MS)
    assert run.loop.stopped
    assert not run.runtime.is_open
    for slave in run.runtime.slaves.values():  # safe values, then Clear
        assert slave.changes[-3:] == [GIVEN, SAFE, bytes(2)]


def test_data_transport_without_a_connection_is_refused() -> None:
    order = RecordOrder(1, Function.DATA_TRANSPORT, 1, 2, data=b"\1", address=3)
    with pytest.raises(UsageError, match="over a class 2 connection only"):
        Ms1(None).job_of(order)
