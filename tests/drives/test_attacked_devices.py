"""Any octets to any SAP of every simulated device, in every state: no exception, no broken state, nothing left open."""

from __future__ import annotations

import random
from collections.abc import Callable
from typing import Final

import pytest
from hypothesis import given
from hypothesis import strategies as st
from property_kit import examples
from slave_kit import MS, Bench

from dpstack import Im0, IoStation
from dpstack.devices.finding import find
from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.dp.slave.events import DeviceFailed, RequestRefused
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.resource_manager import ConnectionClosed, ConnectionOpened, ms2_of
from dpstack.fdl.interface import Reply
from dpstack.fdl.telegram import Kind, Telegram
from dpstack.gsd.identifiers import io_lengths
from dpstack.slave import DpSlave, SlaveDescription

INITIATE: Final = "57 00 00 00 00 64 01 00 00 00 00 00 00 02 00 02 00 00 00 00"
#: right requests, which :meth:`Attacker.bent` damages
PDUS: Final = [
    "",
    "",
    "",
    INITIATE,
    "5E 00 FF F0",
    "5E 00 2F F0",
    "5F 00 2F 0A 01 01 01 01 10 01 03 A2 00 00",
    "5F 00 2F 0A 02 01 00 01 30 01 00 05 00 00",
    "5F 00 2F 10 01 02 01 01 10 01 03 A2 00 00 42 01 00 05",
    "5F 00 FF 04 08 00 FD E8",
    "5F 00 FF 04 08 00 FD E9",
    "5E 01 01 10",
    "5F 01 01 01 55",
    "51 00 02 01 55",
    "48 01",
    "58 00 25",
    "5C 01 02 00",
    "56 30 00 C8",
]


def drive(kind: str, telegram: str) -> Device:
    return find(kind).device(telegram, {})


def own_slave() -> Device:
    description = SlaveDescription.simple(0x4711, inputs=2, outputs=1, name="valves", dpv1=True, alarms=("process",))
    return DpSlave(description, lambda outputs, elapsed: bytes(2), im=[Im0(order_id="V-8")], ms2=2)


DEVICES: Final[dict[str, Callable[[], Device]]] = {
    "demag": lambda: drive("demag-dedrive", "PPO1"),
    "fuji": lambda: drive("fuji-frenic", "PPO1"),
    "keb": lambda: drive("keb-f5", "PCH+8/8"),
    "imo": lambda: drive("imo-hd2", "PKW+12"),
    "ls": lambda: drive("ls-s100", "ST1"),
    "io station": lambda: IoStation.of(["8 DI", "8 DO", "2 AI"], name="io"),
    "own slave": own_slave,
}


class Attacker:
    """Masters 2, 9 and 1; the first brings the slave into data exchange whenever it is not."""

    def __init__(self, device: Device, seed: int) -> None:
        self.bench = Bench(device, SlaveApp(device, address=8))
        self.app = self.bench.app
        self.random = random.Random(seed)
        self.config = device.configs[0]
        self.server_saps = [48]
        self.prm = self.find_prm(device)

    def find_prm(self, device: Device) -> bytes:
        """The shortest parameters that the device accepts, with all of DP-V1 enabled that it has."""
        head = bytes.fromhex("80 01 01 0B") + device.ident.to_bytes(2, "big") + b"\0"
        for status in (b"\x80\xfc\0", b"\x80\x40\0", b"\x80\0\0", b"\0\0\0", b""):
            for length in range(16):
                octets = head + status + bytes(length)
                if self.bring_up(octets):
                    return octets
        raise AssertionError("it takes no parameters")

    def bring_up(self, prm: bytes) -> bool:
        self.bench.prm_and_cfg(prm, self.config)
        self.bench.diag()
        return self.app.state is SlaveAppState.DATA_EXCH

    def ask(self, dsap: int | None, data: bytes, sa: int, ssap: int | None) -> Reply:
        reply = self.app.serve(Telegram(Kind.SD2, 8, sa, 0x5D, dsap, ssap, data), self.bench.now)
        assert reply is not None
        assert len(reply.data) <= 244
        if dsap == 49 and reply.data[:1] == b"\x56":
            self.server_saps = [*self.server_saps, reply.data[1]][-3:]
        return reply

    def bent(self, octets: bytes) -> bytes:
        """Cut, lengthened, or with other bits."""
        rnd, data = self.random, bytearray(octets)
        for _ in range(rnd.choice((0, 0, 1, 2, 3)) if data else 0):
            at = rnd.randrange(len(data)) if data else 0
            match rnd.randrange(4):
                case 0 if data:
                    data[at] = rnd.randrange(256)
                case 1:
                    del data[at:]
                case 2:
                    data += rnd.randbytes(rnd.randrange(240))
                case _:
                    data[at:at] = rnd.randbytes(1)
        return bytes(data[:244])

    def step(self) -> None:
        rnd = self.random
        self.bench.pass_time(rnd.choice((1, 1, 1, 5, 40)) * MS)
        sa = rnd.choice((2, 2, 2, 2, 9, 1))
        what = rnd.random()
        if self.app.master is None and what < 0.4:
            assert self.bring_up(self.prm)
        elif what < 0.05:
            self.ask(61, self.bent(self.prm), sa, 62)
        elif what < 0.07:
            self.ask(rnd.randrange(64), rnd.randbytes(rnd.randrange(20)), sa, rnd.choice((62, 50, 51, None)))
        elif what < 0.08:
            self.bench.control(rnd.randbytes(rnd.randrange(4)), sa)
        elif what < 0.082:
            self.app.restart(self.bench.now)
        elif what < 0.2:
            wrong = rnd.random() < 0.02
            self.ask(None, rnd.randbytes(rnd.randrange(30) if wrong else io_lengths(self.config)[1]), sa, None)
        elif what < 0.25:
            self.ask(49, bytes.fromhex(INITIATE), sa, 50)
            self.ask(49, b"", sa, 50)
            self.ask(self.server_saps[-1], b"", sa, 50)
        else:
            sap = rnd.choice((51, 51, 51, 50, 49, *self.server_saps, *self.server_saps))
            ssap = 51 if sap > 49 else 50
            for _ in range(rnd.randrange(1, 4)):
                self.ask(sap, self.bent(bytes.fromhex(rnd.choice(PDUS))), sa, ssap)


@pytest.mark.parametrize("name", DEVICES)
@examples(1, soak=100)
@given(seed=st.integers(0, 1 << 32))
def test_any_octets_to_any_sap(name: str, seed: int) -> None:
    device = DEVICES[name]()
    attacker = Attacker(device, seed)
    app = attacker.app
    events = app.take_events()
    for _ in range(400):
        attacker.step()
        assert app.failure is None
        events += app.take_events()
    assert not [event for event in events if isinstance(event, DeviceFailed)]
    # silence gives every connection back, and the slave is as it was
    attacker.bench.pass_time(3_000_000 * MS)
    assert ms2_of(app).connections == ()
    assert ms2_of(app).free == device.ms2
    events += app.take_events()
    opened = sum(isinstance(event, ConnectionOpened) for event in events)
    assert opened == sum(isinstance(event, ConnectionClosed) for event in events) == app.stats.connections
    app.restart(attacker.bench.now)
    assert attacker.bring_up(attacker.prm)


@pytest.mark.parametrize("name", ["ls", "io station", "own slave"])
def test_garbage_of_one_master_fills_no_log(name: str) -> None:
    attacker = Attacker(DEVICES[name](), 1)
    app, rnd = attacker.app, attacker.random
    app.take_events()
    told = 0
    for _ in range(3_000):
        attacker.ask(51, rnd.randbytes(rnd.randrange(1, 244)), 2, 51)
        told += sum(isinstance(event, RequestRefused) for event in app.take_events())
    assert app.state is SlaveAppState.DATA_EXCH
    assert app.stats.refused > 2_000
    assert told <= 50
