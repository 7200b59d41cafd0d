"""Octets to the port of EPICS, guided by the structure of Channel Access.

In memory. The first octet of the input says how far the client comes by itself: nowhere, past the greeting, past its
channels, past some monitors; one that was cut off comes back. The rest is pieces: octets as they are, or a right
message with some octets bent; each goes to the connection or, if it says so, as a datagram of searches. Behind a piece,
if it says so, a value changes, a slave is lost, or a slave leaves. Judged: nothing reaches the loop's handler; an order
comes only of a name that is listed, with its type; texts are printable; another client has its value meanwhile; no
connection, task or watcher is left.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import struct
from types import SimpleNamespace
from typing import Any, Final
from unittest import mock

from dpstack.bridge import processor_share
from dpstack.bridge.epics import circuit, connector, server
from dpstack.plant.orders import DriveOrder, SetOutputs
from tests.bridge_epics import ca_client as by
from tests.fuzz.frame import Cutter, Target, assert_plain
from tests.fuzz.memory_transport import MemoryTransport
from tests.fuzz.quick_loop import quick_loop

_NO_TIME: Final = SimpleNamespace(thread_time=float, monotonic=float)
_NO_SOCKET: Final = SimpleNamespace(setsockopt=lambda *_: None)
_ASKED: Final = struct.pack(">fffHH", 0, 0, 0, 5, 0)


def _message(
    command: int, type_: int = 0, count: int = 0, first: int = 0, second: int = 0, payload: bytes = b""
) -> bytes:
    payload += bytes(-len(payload) % 8)
    return by.HEADER.pack(command, len(payload), type_, count, first, second) + payload


def _create(name: str, cid: int) -> bytes:
    return _message(by.CREATE, first=cid, second=13, payload=name.encode() + b"\0")


_GREETING: Final = (
    _message(by.VERSION, count=13) + _message(by.HOST, payload=b"h\0") + _message(by.USER, payload=b"u\0")
)
_NAMES: Final = (
    *("DP:valves:in:level", "DP:valves:out:lamp", "DP:valves:out:flow", "DP:valves:out:horn", "DP:hoist:cmd:speed"),
    *("DP:hoist:cmd:start", "DP:hoist:drive:faults.VAL$", "DP:bus:mode", "DP:nothing"),
)
#: connections of the hostile client, one after the other
_MOST_WIRES: Final = 8
#: the first channels that a server gives have the numbers from 0 on
_CHANNELS: Final = b"".join(_create(name, number) for number, name in enumerate(_NAMES))
_MONITORS: Final = b"".join(
    _message(by.EVENT_ADD, by.TIME + type_, 1, number, number, _ASKED)
    for number, type_ in enumerate((by.DOUBLE, by.ENUM, by.LONG))
)
_FIRST: Final = (b"", _GREETING, _GREETING + _CHANNELS, _GREETING + _CHANNELS + _MONITORS)
_RIGHT: Final = (
    *(_create(name, number) for number, name in enumerate(_NAMES, 10)),
    *(_message(by.READ, type_, 0, 1, 7) for type_ in (by.STRING, by.ENUM, by.DOUBLE, by.CTRL_ENUM, by.CTRL_DOUBLE)),
    _message(by.READ, by.TIME + by.CHAR, 4096, 6, 7),
    *(_message(by.WRITE_NOTIFY, by.ENUM, 1, sid, 9, struct.pack(">H", 1)) for sid in (0, 1, 3, 5)),
    *(_message(by.WRITE_NOTIFY, by.DOUBLE, 1, sid, 9, struct.pack(">d", 0.5)) for sid in (1, 2, 4)),
    _message(by.WRITE_NOTIFY, by.STRING, 1, 2, 9, b"17\0"),
    _message(by.WRITE_NOTIFY, by.PUT_ACKS, 1, 1, 9, b"\0\1"),
    _message(by.WRITE, by.STRING, 1, 1, 9, b"true\0"),
    _message(by.EVENT_ADD, by.TIME + by.DOUBLE, 1, 0, 5, _ASKED),
    _message(by.EVENT_ADD, by.STRING, 0, 2, 6, _ASKED),
    _message(by.EVENT_CANCEL, by.TIME + by.DOUBLE, 1, 0, 0),
    _message(by.EVENTS_OFF),
    _message(by.EVENTS_ON),
    _message(by.CLEAR, first=1, second=1),
    _message(by.ECHO),
    _message(by.SEARCH, 10, 13, 5, 5, b"DP:bus:mode\0"),
    _message(by.SEARCH, 5, 13, 6, 6, b"DP:valves:in:level.EGU\0"),
    _message(by.VERSION, 1, 13, 3),
)


def _bent(octets: bytes, script: Cutter) -> bytes:
    made = bytearray(octets)
    for _ in range(script.octet() & 7):
        at, how = script.word() % len(made), script.octet()
        if how < 64:
            made[at : at + 2] = (0xFFFF, 0x7FFF, 0, 4096)[how & 3].to_bytes(2, "big")
        elif how < 96:
            made[at:at] = script.take(how & 15)
        else:
            made[at] = script.octet()
    return bytes(made)


class _Wire(MemoryTransport):
    """A connection of ``address`` to ``served``, by its streams."""

    def __init__(self, served: server.Server, address: str) -> None:
        super().__init__(address, 5064)
        loop = asyncio.get_running_loop()
        self.reader = asyncio.StreamReader(loop=loop)
        self.protocol = asyncio.StreamReaderProtocol(self.reader, loop=loop)
        self.protocol.connection_made(self)
        writer = asyncio.StreamWriter(self, self.protocol, self.reader, loop)
        self.task = loop.create_task(served._serve(self.reader, writer))

    def get_extra_info(self, name: str, default: Any = None) -> Any:
        return _NO_SOCKET if name == "socket" else super().get_extra_info(name, default)

    def get_write_buffer_size(self) -> int:
        return 0

    def pause_reading(self) -> None:
        return

    def resume_reading(self) -> None:
        return

    async def send(self, octets: bytes) -> bytes:
        """Send, let the server work, return its new octets."""
        before = len(self.said)
        if octets and not self.closed:
            self.reader.feed_data(octets)
        await asyncio.sleep(0.7)  # a put that waits for its value takes 0.5 s
        return bytes(self.said[before:])

    async def end(self) -> None:
        if not self.closed:
            self.reader.feed_eof()
        await self.task


def _change(rig: by.Rig, how: int) -> None:
    """A value changes, the slave is lost or comes back, or the drive leaves for good."""
    values = rig.values["8"]
    if how == 0:
        rig.show("8", values | {"fields": values["fields"] | {"level": values["fields"]["level"] + 1}})
    elif how == 1:
        rig.show("8", values | {"state": "fault" if values["state"] == "data_exchange" else "data_exchange"})
    elif how == 2 and "9" in rig.slaves:
        del rig.slaves["9"], rig.values["9"]
        rig.plant()
        rig.snapshot()


def _judge(order: SetOutputs | DriveOrder) -> None:
    if isinstance(order, SetOutputs):
        [(name, value)] = order.values.items()
        assert (name, type(value)) in (("lamp", bool), ("flow", int)), order
        assert isinstance(value, int)
        assert 0 <= value <= 0xFFFF
    else:
        assert order.address == 9
        # the range is judged by the run
        assert order.operation != "speed" or math.isfinite(float(order.value))  # type: ignore[arg-type]


async def _main(octets: bytes) -> None:
    script = Cutter(octets)
    rig = by.Rig()
    await rig.connector.open()
    served = rig.connector._server
    assert served is not None
    try:
        rig.plant()
        rig.snapshot()
        await rig.connector.write_changes()
        good = _Wire(served, "10.0.0.1")
        assert await good.send(_FIRST[3])
        first = _FIRST[script.octet() & 3]
        wires: list[_Wire] = []
        while script.at < len(octets) and len(wires) < _MOST_WIRES:
            if not wires or wires[-1].closed:
                wires.append(_Wire(served, "10.0.0.2"))
                await wires[-1].send(first)
            kind = script.octet()
            piece = script.take(kind & 31) if kind & 128 else _bent(_RIGHT[kind % len(_RIGHT)], script)
            if kind & 64:
                datagram(served, piece)
            else:
                await wires[-1].send(piece)
            _change(rig, script.octet() & 7)
            await rig.connector.write_changes()
        read = _message(by.READ, by.DOUBLE, 1, 0, 7)
        if rig.values["8"]["state"] != "data_exchange":
            _change(rig, 1)  # until then the value of before stands there
            await rig.connector.write_changes()
        level = float(rig.values["8"]["fields"]["level"])
        assert struct.pack(">d", level) in await good.send(read)
        for one in (*wires, good):
            await one.end()
    finally:
        rig.connector.close()
    assert not served.circuits
    assert not any(variable.watchers for variable in rig.connector._variables.values())
    for order in rig.given:
        _judge(order)
    for text in (*rig.told, *(one.text for one in rig.refused)):
        assert_plain(text)


def datagram(served: server.Server, octets: bytes) -> None:
    """As the server takes a datagram: what it cannot read has no answer."""
    sent: list[bytes] = []
    searches = server._Searches(served)
    transport: Any = SimpleNamespace(sendto=lambda answer, _: sent.append(answer))
    searches.connection_made(transport)
    searches.datagram_received(octets, ("10.0.0.3", 4711))
    assert sum(map(len, sent)) <= 2 * len(octets) + 32


def run(octets: bytes) -> None:
    with contextlib.ExitStack() as patched:
        for module in (circuit, connector, server, processor_share):
            patched.enter_context(mock.patch.object(module, "time", _NO_TIME))
        patched.enter_context(mock.patch.object(connector, "_SETTLE_S", 0.1))
        quick_loop().play(_main(octets))


TARGET = Target(
    run=run,
    covers=tuple(f"dpstack.bridge.epics.{one}" for one in ("circuit", "server", "variables", "connector")),
    executions=100_000,
    compares=False,
    words=(b"DP:valves:out:flow\0", b"DP:hoist:cmd:stop\0", b".VAL$", struct.pack(">I", 0xFFFF_FFFF), b"\xff\xff\0\0"),
)
