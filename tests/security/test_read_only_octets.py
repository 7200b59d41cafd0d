"""A read-only bus by its octets: no call of the API and no order of `dpstack ctl` sends a request that writes."""

from __future__ import annotations

import asyncio
import contextlib
import inspect
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from api_kit import FAN, HOIST, RAW, bus_of, in_virtual_time

import dpstack
from dpstack.api.config.config import make_config
from dpstack.api.control.commands import KINDS
from dpstack.api.control.handlers import control_run

OWN = 5
#: SAP 56 RD_Inp, 57 RD_Outp, 59 Get_Cfg, 60 Slave_Diag: services that read, and carry no data
READS = {56, 57, 59, 60}
SRD_LOW, SRD_HIGH, FDL_STATUS, IDENT, LSAP_STATUS = 12, 13, 9, 14, 15
#: methods that no program calls to make something happen on the bus
INNER = {"end", "on_payload", "on_refused", "on_round", "publish_status", "leave", "listen_to_events", "publish"}
INNER |= {"notice", "check_open", "hurry", "command", "order", "open", "close", "fitting", "poll_interval_ns"}
INNER |= {"find_drive", "output_field", "check_outputs", "conspicuous_text", "past_events", "outputs_taken"}


def why_it_may_write(octets: bytes) -> str | None:
    """None for a token, an answer, or a request that only reads; by the octets alone."""
    if octets[0] == 0xDC or octets[0] == 0xE5:
        return None
    body = octets[4:-2] if octets[0] == 0x68 else octets[1:-2]
    da, sa, fc = body[:3]
    if not fc & 0x40:  # an answer
        return None
    if fc & 0x0F in (FDL_STATUS, IDENT, LSAP_STATUS):
        return None
    saps = 3 + (da >> 7)
    dsap = body[3] if da & 0x80 else None
    rest = body[saps + (sa >> 7) :]
    if fc & 0x0F in (SRD_LOW, SRD_HIGH) and dsap in READS and not rest:
        return None
    return f"function {fc & 0x0F}, SAP {dsap}, {rest.hex(' ')}"


def sender_of(octets: bytes) -> int | None:
    """The station that sent ``octets``; None for an acknowledgement, which names nobody."""
    at = {0x68: 5, 0xE5: None}.get(octets[0], 2)
    return None if at is None else octets[at] & 0x7F


class _All(dpstack.Outputs):
    octets: dpstack.Octets = dpstack.at(0, 1)


#: arguments of every method; those that are missing here are called without
ARGS: dict[str, Callable[[Path], tuple[tuple[Any, ...], dict[str, Any]]]] = {
    "Bus.add_slave": lambda _: (({"name": "new", "address": 20, "ident": 1, "config": "20"},), {}),
    "Bus.remove": lambda _: (("raw",), {}),
    "Bus.cpu": lambda _: (("press",), {}),
    "Bus.drive": lambda _: (("hoist",), {}),
    "Bus.slave": lambda _: (("raw",), {}),
    "Bus.why": lambda _: (("raw",), {}),
    "Bus.rotated": lambda _: ((2,), {}),
    "Bus.until": lambda _: ((lambda: True,), {}),
    "Bus.wait_state": lambda _: ((dpstack.Mode.CLEAR,), {"timeout": 1}),
    "Bus.record": lambda path: ((path / "r.csv",), {}),
    "Slave.read": lambda _: ((1, 47), {}),
    "Slave.read_time_stamps": lambda _: ((100,), {}),
    "Slave.write": lambda _: ((1, 47, b"\x01"), {}),
    "Slave.hart": lambda _: ((0,), {}),
    "Slave.write_im": lambda _: ((dpstack.Im1(),), {}),
    "Slave.changes": lambda _: (("a",), {}),
    "Slave.follow": lambda _: (("a", int), {}),
    "Slave.inputs_as": lambda _: ((dpstack.Inputs,), {}),
    "Slave.outputs_as": lambda _: ((dpstack.Outputs,), {}),
    "Slave.send": lambda _: ((_All(octets=b"\xff"),), {}),
    "Slave.until": lambda _: ((lambda _: True,), {"timeout": 1}),
    "Slave.value": lambda _: (("a", int), {}),
    "Slave.update": lambda _: (({"a": 1},), {}),
    "Slave.reparameterise": lambda _: ((), {"user_prm": "00"}),
    "Slave.outputs": lambda _: ((b"\xff",), {}),
    "Slave.wait_state": lambda _: ((dpstack.SlaveState.DATA_EXCHANGE,), {"timeout": 1}),
    "Drive.speed": lambda _: ((0.5,), {}),
    "Drive.frequency": lambda _: ((25.0,), {}),
    "Drive.rpm": lambda _: ((750.0,), {}),
    "Slave.order": lambda _: (("preset",), {"value": 1}),
    "Slave.quality": lambda _: (("raw",), {}),
    "Slave.readings": lambda _: (("raw",), {}),
    "Drive.compare": lambda path: ((path / "none.toml",), {}),
    "Drive.dump": lambda path: ((path / "d.toml",), {}),
    "Drive.parameter": lambda _: ((480,), {}),
    "Drive.read": lambda _: ((480,), {}),
    "Drive.read_array": lambda _: ((480, 2), {}),
    "Drive.read_many": lambda _: (([480],), {}),
    "Drive.write": lambda _: ((480, 1.0), {}),
    "Drive.write_map": lambda _: ((), {"inputs": "-", "outputs": "-"}),
    "Group.write": lambda _: (({"raw": b"\xff"},), {}),
    "Group.exchange": lambda _: (({"raw": b"\xff"},), {}),
    "Class2.diagnosis": lambda _: ((9,), {}),
    "Class2.config": lambda _: ((9,), {}),
    "Class2.inputs": lambda _: ((9,), {}),
    "Class2.outputs": lambda _: ((9,), {}),
    "Class2.set_address": lambda _: ((4, 44), {}),
    "Class2.connect": lambda _: ((9,), {}),
    "Fdl.sda": lambda _: ((9, b"\x01"), {}),
    "Fdl.sdn": lambda _: ((9, b"\x01"), {}),
    "Fdl.srd": lambda _: ((9, b"\x01"), {"dsap": 20}),
    "Fdl.msrd": lambda _: ((9, b"\x01"), {}),
    "Fdl.fdl_status": lambda _: ((9,), {}),
    "Fdl.ident": lambda _: ((9,), {}),
    "Fdl.lsap_status": lambda _: ((9, 20), {}),
    "Fdl.sap": lambda _: ((20,), {}),
}


async def call(thing: object, name: str, args: tuple[Any, ...], options: dict[str, Any]) -> None:
    """Call a method, or set a property; await, enter or read once what comes back."""
    if isinstance(inspect.getattr_static(type(thing), name), property):
        setattr(thing, name, *args)
        return
    result = getattr(thing, name)(*args, **options)
    async with asyncio.timeout(0.04):
        if hasattr(result, "__aenter__"):
            async with result as inner:
                await asyncio.sleep(0.01)
                if hasattr(inner, "__anext__"):
                    await anext(aiter(inner))
        elif inspect.isawaitable(result):
            await result
        elif hasattr(result, "__aiter__"):
            await anext(aiter(result))


def members(kind: type) -> list[str]:
    found = []
    for name in dir(kind):
        one = inspect.getattr_static(kind, name)
        changes = one.fset is not None if isinstance(one, property) else callable(one)
        if not name.startswith("_") and changes and name not in INNER:
            found.append(name)
    return found


@in_virtual_time
async def test_no_call_and_no_order_of_a_read_only_bus_sends_anything_that_writes() -> None:
    asked: set[str] = set()
    async with bus_of(RAW, {**HOIST, "telegram": "PPO1"}, gap=1) as owner:
        await owner.ready()
        await owner.operate()
        world = owner.world
        assert world is not None
        sent: list[bytes] = []
        world.log.listener = lambda entry: sent.append(entry.octets)
        config = make_config(
            "virtual", 500_000, OWN, [RAW, {**HOIST, "telegram": "PPO1"}, FAN], bus={"read_only": True}
        )
        async with dpstack.open_bus(config, world=world) as bus:
            await asyncio.sleep(0.1)
            with tempfile.TemporaryDirectory() as folder:
                things = [
                    bus.fdl,
                    bus.class2,
                    bus.slave("raw"),
                    bus.slave("hoist"),
                    bus.drive("hoist"),
                    bus.group(),
                    bus,
                ]
                for thing in things:
                    kind = type(thing)
                    for name in members(kind):
                        if (kind.__name__, name) == ("Bus", "stop"):
                            continue  # the end of the bus, below
                        given = ARGS.get(f"{kind.__name__}.{name}")
                        args, options = ((), {}) if given is None else given(Path(folder))
                        with contextlib.suppress(dpstack.DpError, TimeoutError, ValueError, StopAsyncIteration):
                            await call(thing, name, args, options)
                        asked.add(f"{kind.__name__}.{name}")
                server = control_run(bus, "pty")
                for spec in KINDS["run"]:
                    if spec.name in ("help", "stop"):
                        continue
                    example = spec.example.split()
                    for words in ([*example], ["raw", *example[1:]], ["9", *example[1:]]):
                        with contextlib.suppress(dpstack.DpError, TimeoutError, ValueError, LookupError):
                            result: Any = server._handlers[spec.name](words if spec.example else [])
                            async with asyncio.timeout(0.04):
                                if callable(result):
                                    result = result(_Client())
                                if inspect.isawaitable(result):
                                    await result
                    asked.add(spec.name)
            with contextlib.suppress(dpstack.DpError):
                await bus.stop()
        world.log.listener = None
        sent = [octets for octets in sent if sender_of(octets) == OWN]
    wrong = {why for octets in sent if (why := why_it_may_write(octets))}
    assert not wrong
    assert len(sent) > 100
    requests = {octets[4 + 3] & 0x7F for octets in sent if octets[0] == 0x68 and octets[4] & 0x80}
    assert requests >= READS  # so they were asked
    assert asked >= {"Slave.write", "Slave.outputs", "Drive.start", "Class2.set_address", "Bus.operate", "Group.write"}


class _Client:
    """The client of a long command, which reads nothing."""

    unread = 0

    async def __call__(self, item: object) -> None:
        return

    def offer(self, line: bytes) -> bool:
        return True

    def check(self) -> None:
        return

    def give_up(self) -> None:
        raise TimeoutError


def test_the_judge_of_octets_knows_writes() -> None:
    writes = ("68 05 05 68 83 85 5D 3D 3E 00 16", "68 05 05 68 83 85 5D 3E 3E 00 16", "68 04 04 68 03 05 5D 01 00 16")
    for octets in (*writes, "68 06 06 68 83 85 5D 37 3E 01 00 16", "68 05 05 68 FF 85 46 3A 3E 00 16"):
        assert why_it_may_write(bytes.fromhex(octets))
    for octets in ("DC 02 05", "10 03 05 49 00 16", "68 05 05 68 83 85 5D 3C 3E 00 16"):
        assert why_it_may_write(bytes.fromhex(octets)) is None
