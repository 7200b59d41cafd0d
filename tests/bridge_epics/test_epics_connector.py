"""The EPICS connector with a client in octets of its own: values, monitors, puts, the end, hostile clients."""

from __future__ import annotations

import asyncio
import math
import socket
import struct
from typing import Any

import pytest
from far_ends import free_port, until

from dpstack.bridge.epics import circuit, connector, server
from dpstack.bridge.epics.connector import EpicsConnector
from dpstack.errors import ConfigError, PortError
from dpstack.plant.orders import DriveOrder, SetOutputs
from dpstack.tcp_address import Listen
from tests.bridge_epics.ca_client import (
    CHAR,
    CLEAR,
    COMM_ALARM,
    CTRL_DOUBLE,
    CTRL_ENUM,
    DOUBLE,
    ECHO,
    ENUM,
    ERROR,
    EVENT_ADD,
    EVENT_CANCEL,
    EVENTS_OFF,
    EVENTS_ON,
    FINE,
    HEADER,
    INVALID,
    MAJOR,
    MINOR,
    NO_ALARM,
    NOCONVERT,
    NOT_FOUND,
    NOWTACCESS,
    PUT_ACKS,
    PUTFAIL,
    READ,
    READ_ALARM,
    SEARCH,
    SERVER_DISCONN,
    STARTED,
    STATE_ALARM,
    STRING,
    TIME,
    UDF_ALARM,
    VALVES,
    WRITE,
    WRITE_NOTIFY,
    Rig,
    reason,
)


async def test_values_have_type_unit_limits_alarm_and_the_time_of_the_value() -> None:
    rig = Rig()
    async with rig.serving(), rig.client() as client:
        level = await client.found("DP:valves:in:level")
        assert (level.type, level.elements, level.rights) == (DOUBLE, 1, 1)
        # 0.1 s after the start, 1 ms old
        assert await client.timed("DP:valves:in:level") == (55.0, NO_ALARM, NO_ALARM, pytest.approx(STARTED + 0.099))
        about = (await client.read("DP:valves:in:level", CTRL_DOUBLE)).payload
        status, severity, precision, unit, high, low = struct.unpack_from(">HHhxx8sdd", about)
        assert (status, severity, precision, unit) == (NO_ALARM, NO_ALARM, 1, b"mbar ab\0")
        assert (low, high) == (-3276.8, 3276.7)
        assert struct.unpack_from(">dd", about, 64) == (0, 0)  # it cannot be set: no limits for that
        assert any("'mbar abs' is shown as 'mbar ab'" in text for text in rig.told)
        # 4e9 does not fit the LONG of Channel Access
        assert (await client.timed("DP:valves:in:count"))[0] == 4_000_000_000.0
        assert await client.timed("DP:valves:out:lamp") == (0, NO_ALARM, NO_ALARM, pytest.approx(STARTED + 0.099))
        states = (await client.read("DP:hoist:drive:state", CTRL_ENUM)).payload
        assert struct.unpack_from(">HHh", states) == (NO_ALARM, NO_ALARM, 11)
        assert states[6 + 5 * 26 :].startswith(b"ready\0")
        assert (await client.timed("DP:hoist:drive:state"))[0] == 5
        assert (await client.timed("DP:bus:mode"))[0] == 3
        assert [(await client.timed(f"DP:valves:in:level.{field}"))[0] for field in ("EGU", "DESC", "AMSG", "VAL")] == [
            "mbar abs", "level of slave 8", "", 55.0,
        ]  # fmt: skip
        # a text as a number: an error, and the connection goes on
        text = await client.found("DP:valves:in:level.DESC")
        client.send(READ, type_=DOUBLE, first=text.sid, second=7)
        assert reason(await client.answer(ERROR))[0] == NOCONVERT
        client.send(EVENT_ADD, type_=DOUBLE, first=text.sid, second=8, payload=struct.pack(">fffHH", 0, 0, 0, 5, 0))
        assert reason(await client.answer(ERROR))[0] == NOCONVERT
        for name in ("DP:valves:in:other", "valves:in:level", "DP:valves:in:level.HIHI", "DP:valves:in:level.VAL$"):
            assert await client.channel(name) is None


async def test_alarms_follow_quality_and_states_and_a_number_stays_beside_its_alarm() -> None:
    rig = Rig()
    fine = rig.values["8"]
    async with rig.serving(), rig.client() as client:

        async def level(change: dict[str, Any]) -> tuple[Any, ...]:
            rig.show("8", fine | change)
            await rig.connector.write_changes()
            return (await client.timed("DP:valves:in:level"))[:3]

        limit = {"quality": "uncertain", "reason": "channel_limit", "text": "upper limit exceeded: slot 2"}
        broken = {"quality": "bad", "reason": "channel_fault", "text": "line break: slot 2, input channel 0"}
        assert await level({"qualities": {"level": limit}}) == (55.0, 11, MINOR)  # HWLIMIT
        assert await level({"qualities": {"level": broken}}) == (55.0, READ_ALARM, INVALID)
        assert (await client.timed("DP:valves:in:level.AMSG"))[0] == "line break: slot 2, input channel 0"
        assert await level({"fields": {"level": None}, "qualities": {}}) == (
            pytest.approx(math.nan, nan_ok=True),
            UDF_ALARM,
            INVALID,
        )
        assert await level({"qualities": {}}) == (55.0, NO_ALARM, NO_ALARM)
        lost = {"state": "fault", "fault": {"text": "no answer", "kind": "silent"}}
        at = rig.t
        assert await level({"qualities": {}} | lost) == (55.0, COMM_ALARM, INVALID)
        # the time of the value, which was there before the slave was lost
        assert (await client.timed("DP:valves:in:level"))[3] == pytest.approx(STARTED + at - 0.001)
        assert (await client.timed("DP:valves:state"))[:3] == (6, STATE_ALARM, MAJOR)
        assert (await client.timed("DP:valves:fault"))[:3] == ("no answer", STATE_ALARM, MAJOR)
        drive = rig.values["9"]["drive"]
        long = "over temperature of the motor in phase U at 140 degrees"
        rig.show("9", FINE | {"drive": drive | {"state": "fault", "faults": [long], "warnings": ["fan"]}})
        await rig.connector.write_changes()
        assert (await client.timed("DP:hoist:drive:state"))[:3] == (10, STATE_ALARM, MAJOR)
        assert (await client.timed("DP:hoist:drive:faults"))[:3] == (long[:39], STATE_ALARM, MAJOR)
        assert (await client.timed("DP:hoist:drive:faults.VAL$"))[:3] == (long.encode(), STATE_ALARM, MAJOR)
        assert (await client.timed("DP:hoist:drive:warnings"))[1:3] == (STATE_ALARM, MINOR)


async def test_monitors_get_changes_and_the_newest_value_after_a_pause() -> None:
    rig = Rig()
    async with rig.serving(), rig.client() as client:
        level = await client.found("DP:valves:in:level")
        await client.monitor(level, 1)
        assert (await client.update(DOUBLE))[0] == 55.0
        fields = rig.values["8"]["fields"]
        rig.show("8", rig.values["8"] | {"fields": fields | {"level": 56}})
        assert await client.update(DOUBLE) == (56.0, NO_ALARM, NO_ALARM, pytest.approx(STARTED + 0.199))
        client.send(EVENTS_OFF)
        client.send(ECHO)
        await client.answer(ECHO)
        for value in (57, 58):
            rig.show("8", rig.values["8"] | {"fields": fields | {"level": value}})
            await rig.connector.write_changes()
        client.send(EVENTS_ON)
        assert (await client.update(DOUBLE))[0] == 58.0
        client.send(EVENT_CANCEL, type_=TIME + DOUBLE, first=level.sid, second=1)
        assert len((await client.answer(EVENT_ADD)).payload) == 0  # the answer to a cancel (spec, EVENT_CANCEL)
        await client.monitor(level, 2, mask=4)  # alarms only
        await client.update(DOUBLE)
        rig.show("8", rig.values["8"] | {"fields": fields | {"level": 59}})
        await rig.connector.write_changes()
        rig.show("8", rig.values["8"] | {"state": "fault"})
        assert (await client.update(DOUBLE))[:3] == (59.0, COMM_ALARM, INVALID)
        client.send(CLEAR, first=level.sid, second=1)
        await client.answer(CLEAR)
        assert rig.connector._variables["DP:valves:in:level", ""].watchers == {}


async def test_puts_give_typed_orders_and_a_read_behind_one_sees_its_value() -> None:
    rig = Rig()
    async with rig.serving(), rig.client() as client:
        lamp = await client.found("DP:valves:out:lamp")
        assert (lamp.type, lamp.rights) == (ENUM, 3)
        assert (await client.put("DP:valves:out:lamp", ENUM, 1)).first == 1
        assert (await client.timed("DP:valves:out:lamp"))[0] == 1
        # as caput writes: without a result, as text, and a read right behind it
        client.send(WRITE, type_=STRING, count=1, first=lamp.sid, second=3, payload=b"false\0")
        assert (await client.timed("DP:valves:out:lamp"))[0] == 0
        assert (await client.put("DP:valves:out:flow", DOUBLE, 12.0)).first == 1
        assert (await client.put("DP:valves:out:flow", STRING, "13")).first == 1
        assert (await client.put("DP:hoist:cmd:start", ENUM, 1)).first == 1
        assert (await client.put("DP:hoist:cmd:start", ENUM, 0)).first == 1  # a button that is released
        assert (await client.put("DP:hoist:cmd:speed", DOUBLE, 0.25)).first == 1
        assert (await client.timed("DP:hoist:cmd:speed"))[0] == 0.25
        assert (await client.put("DP:hoist:cmd:stop", STRING, "stop")).first == 1
        assert rig.given == [
            SetOutputs(8, {"lamp": True}),
            SetOutputs(8, {"lamp": False}),
            SetOutputs(8, {"flow": 12}),
            SetOutputs(8, {"flow": 13}),
            DriveOrder(9, "start"),
            DriveOrder(9, "speed", 0.25),
            DriveOrder(9, "stop"),
        ]
        assert rig.refused == []


async def test_octets_of_every_value_are_read_and_put_as_a_list() -> None:
    rig = Rig(allow=("valves.*",))
    rig.slaves["8"] = VALVES | {"outputs": [*VALVES["outputs"], {"name": "raw", "at": "bytes@4:4"}]}
    fields = rig.values["8"]["fields"]
    rig.values["8"] = FINE | {"fields": fields | {"raw": "7f80ff00"}, "fault": {"text": "Süd", "kind": "silent"}}
    async with rig.serving(), rig.client() as client:
        raw = await client.found("DP:valves:out:raw")
        assert (raw.type, raw.elements) == (CHAR, 4)
        assert (await client.read("DP:valves:out:raw", CHAR)).payload[:4] == bytes([0x7F, 0x80, 0xFF, 0])
        assert struct.unpack(">4d", (await client.read("DP:valves:out:raw", DOUBLE)).payload) == (127, 128, 255, 0)
        assert (await client.read("DP:valves:fault.VAL$", CHAR)).payload.startswith("Süd".encode())
        texts = b"".join(text.ljust(40, b"\0") for text in (b"1", b"2", b"200", b"255"))  # `caput -a`
        client.send(WRITE_NOTIFY, type_=STRING, count=4, first=raw.sid, second=9, payload=texts)
        assert (await client.answer(WRITE_NOTIFY, ERROR)).first == 1
        client.send(WRITE_NOTIFY, type_=CHAR, count=4, first=raw.sid, second=9, payload=bytes([9, 128, 7, 255]))
        assert (await client.answer(WRITE_NOTIFY, ERROR)).first == 1
        for wrong in (300.0, -129.0, 1.5):
            client.send(
                WRITE_NOTIFY, type_=DOUBLE, count=4, first=raw.sid, second=9, payload=struct.pack(">4d", 1, 2, 3, wrong)
            )
            refused = reason(await client.answer(WRITE_NOTIFY, ERROR))
            assert refused == (PUTFAIL, f"an octet is a whole number from 0 to 255, not {wrong!r}")
    assert rig.given == [
        SetOutputs(8, {"raw": bytes([1, 2, 200, 255])}),
        SetOutputs(8, {"raw": bytes([9, 128, 7, 255])}),
    ]


async def test_the_end_of_a_put_comes_behind_the_value_and_the_state_of_the_drive() -> None:
    rig = Rig()

    async def snapshots() -> None:
        drive = rig.values["9"]["drive"]
        await until(lambda: rig.given)
        await asyncio.sleep(0.03)  # a snapshot from before the order has come
        rig.show("9", FINE | {"drive": drive | {"state": "running", "running": True}})

    async with rig.serving(), rig.client() as client:
        news = asyncio.create_task(snapshots())
        assert (await client.put("DP:hoist:cmd:start", ENUM, 1)).first == 1
        assert (await client.timed("DP:hoist:drive:state"))[0] == 6
        await news
        flow = await client.found("DP:valves:out:flow")
        await client.monitor(flow, 1)
        assert (await client.update(flow.type))[0] == 7
        client.send(WRITE_NOTIFY, type_=DOUBLE, count=1, first=flow.sid, second=9, payload=struct.pack(">d", 12))
        assert (await client.answer(WRITE_NOTIFY, EVENT_ADD)).command == EVENT_ADD


async def test_a_refused_put_is_an_error_with_its_reason_and_is_reported() -> None:
    rig = Rig()
    async with rig.serving(), rig.client() as client:
        assert (await client.found("DP:valves:out:horn")).rights == 1
        found = [
            reason(await client.put(name, type_, value))
            for name, type_, value in (
                ("DP:valves:out:horn", ENUM, 1),
                ("DP:valves:in:level", DOUBLE, 3.0),
                ("DP:valves:out:lamp", ENUM, 2),
                ("DP:valves:out:flow", DOUBLE, 1.5),
                ("DP:valves:out:flow", DOUBLE, 70_000.0),
                ("DP:valves:out:flow", DOUBLE, math.nan),
                ("DP:valves:out:flow", STRING, "much"),
                ("DP:valves:out:flow", DOUBLE, 4000.0),
            )
        ]
        assert found == [
            (NOWTACCESS, "it is not in allow_commands"),
            (NOWTACCESS, "it can only be read"),
            (PUTFAIL, "it takes false or true (0 or 1), not 2"),
            (PUTFAIL, "valves.flow takes u16, not 1.5"),
            (PUTFAIL, "valves.flow takes u16, not 70000"),
            (PUTFAIL, "nan is not a finite number"),
            (PUTFAIL, "'much' is not a number"),
            (PUTFAIL, "the run refuses 4000"),
        ]
        assert (await client.timed("DP:valves:out:flow"))[0] == 7
        lamp = await client.found("DP:valves:out:lamp")
        client.send(WRITE_NOTIFY, type_=PUT_ACKS, count=1, first=lamp.sid, second=9, payload=b"\0\1")
        assert reason(await client.answer(ERROR)) == (
            PUTFAIL,
            "it takes a plain value; alarms cannot be acknowledged here",
        )
        rig.show("8", rig.values["8"] | {"state": "fault"})
        refused = await client.put("DP:valves:out:lamp", ENUM, 1)
        assert reason(refused) == (PUTFAIL, "the slave is not in data exchange")
    assert rig.given == []
    assert len(rig.refused) == 10
    # neither of the names is proved
    assert rig.refused[0].text == (
        "epics (127.0.0.1, which says it is 'anna'): order valves.horn refused: it is not in allow_commands"
    )


async def test_the_end_of_the_bus_is_invalid_and_then_the_connection_ends() -> None:
    rig = Rig()
    async with rig.serving() as serving, rig.client() as client:
        level = await client.found("DP:valves:in:level")
        await client.monitor(level, 1)
        await client.update(DOUBLE)
        rig.end()
        serving.cancel()
        assert (await client.update(DOUBLE))[:3] == (55.0, COMM_ALARM, INVALID)
        assert await client.reader.read() == b""
        with pytest.raises(OSError):
            await asyncio.open_connection("127.0.0.1", rig.connector.port)


async def test_a_fault_of_the_connector_ends_all_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    rig = Rig()
    async with rig.serving() as serving, rig.client() as client:
        await client.monitor(await client.found("DP:valves:in:level"), 1)
        await client.update(DOUBLE)

        async def fail() -> None:
            raise RuntimeError

        monkeypatch.setattr(rig.connector, "write_changes", fail)
        assert await client.reader.read() == b""
        await until(serving.done)
        assert isinstance(serving.exception(), RuntimeError)


async def test_a_slave_that_is_removed_ends_its_channels_alone() -> None:
    rig = Rig()
    async with rig.serving(), rig.client() as client:
        await client.found("DP:valves:in:level")
        speed = await client.found("DP:hoist:drive:speed")
        await client.monitor(speed, 1)
        await client.answer(EVENT_ADD)
        del rig.slaves["9"], rig.values["9"]
        rig.plant()
        rig.snapshot()
        gone = await client.answer(SERVER_DISCONN)
        assert gone.first == 2
        assert await client.channel("DP:hoist:drive:speed") is None
        assert (await client.timed("DP:valves:in:level"))[0] == 55.0


async def test_a_text_that_is_a_number_no_more_ends_its_channel() -> None:
    rig = Rig()
    async with rig.serving(), rig.client() as client:
        fault = await client.found("DP:valves:fault")
        client.send(EVENT_ADD, type_=DOUBLE, first=fault.sid, second=8, payload=struct.pack(">fffHH", 0, 0, 0, 5, 0))
        assert (await client.answer(EVENT_ADD)).payload == bytes(8)
        rig.show("8", rig.values["8"] | {"state": "fault", "fault": {"text": "no answer", "kind": "silent"}})
        assert (await client.answer(SERVER_DISCONN)).first == 1
        assert (await client.timed("DP:valves:fault"))[0] == "no answer"


async def test_searches_are_answered_for_known_names_only_by_udp_and_tcp() -> None:
    rig = Rig()
    name = b"DP:bus:mode\0\0\0\0\0"
    ask = bytes.fromhex("0000 0000 0001 000d 0000 0123 0000 0000") + HEADER.pack(SEARCH, 16, 5, 13, 77, 77) + name
    other = ask.replace(b"mode", b"mood")
    async with rig.serving(), rig.client() as client:
        port = rig.connector.port
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            sock.setblocking(False)
            loop = asyncio.get_running_loop()
            for octets in (b"", b"\xff" * 40, other, b"\0" * 3000, ask):
                sock.sendto(octets, ("127.0.0.1", port))
            answer = await asyncio.wait_for(loop.sock_recv(sock, 1000), 20)
            # the version with the number of its request, then the port, the sender's own address, the number of the
            # search, and the version again
            version = bytes.fromhex("0000 0000 0001 000d 0000 0123 0000 0000")
            assert answer == version + HEADER.pack(SEARCH, 8, port, 0, 0xFFFF_FFFF, 77) + bytes.fromhex(
                "000d 0000 0000 0000"
            )
        # EPICS_CA_NAME_SERVERS: libca sends another version in front of each search
        client.send(VERSION_AGAIN, type_=1, count=13)
        client.send(SEARCH, type_=10, count=13, first=5, second=5, payload=name)
        client.send(SEARCH, type_=10, count=13, first=6, second=6, payload=b"nothing\0")
        assert (await client.answer(SEARCH)).second == 5
        assert (await client.answer(NOT_FOUND)).second == 6


VERSION_AGAIN = 0


async def test_a_client_that_does_not_read_holds_up_nobody_and_is_cut_off(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(circuit, "PATIENCE_S", 0.2)
    rig = Rig()
    async with rig.serving(), rig.client() as deaf, rig.client() as well:
        deaf.writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        text = await well.found("DP:hoist:drive:faults.VAL$")
        await well.monitor(text, 1)
        await well.update(CHAR)
        sid = (await deaf.found("DP:hoist:drive:faults.VAL$")).sid
        deaf.reader._transport.pause_reading()  # type: ignore[attr-defined]
        for number in range(300):
            deaf.send(
                EVENT_ADD,
                type_=TIME + CHAR,
                count=4096,
                first=sid,
                second=number,
                payload=struct.pack(">fffHH", 0, 0, 0, 5, 0),
            )
        # until the socket of the computer, of any size, is full: updates that wait for a slow client are joined
        for number in range(1000):
            rig.show("9", FINE | {"drive": {"state": "fault", "faults": [f"fault {number}"]}})
            assert (await well.update(CHAR))[0] == f"fault {number}".encode()
            if number >= 2 and rig.connector.dropped:
                break
            await asyncio.sleep(0.01)
        assert rig.connector.dropped == 1
        await until(lambda: any("did not read its values" in text for text in rig.told))
        assert len(rig.connector._server.circuits) == 1  # type: ignore[union-attr]


@pytest.mark.parametrize(
    "octets",
    [
        b"\xff" * 64,
        HEADER.pack(READ, 0, 6, 1, 99, 1),
        HEADER.pack(WRITE_NOTIFY, 8, 99, 1, 0, 1) + bytes(8),
        HEADER.pack(EVENT_ADD, 16, 999, 1, 0, 1) + bytes(16),
        HEADER.pack(WRITE_NOTIFY, 0xFFFF, 6, 0, 0, 1) + struct.pack(">II", 1 << 30, 1 << 27),
        b"GET / HTTP/1.1\r\nHost: x\r\n\r\n",
    ],
    ids=["noise", "channel", "type of a put", "type of a monitor", "length", "http"],
)
async def test_octets_that_are_no_message_end_their_connection_alone(octets: bytes) -> None:
    rig = Rig()
    async with rig.serving(), rig.client() as good, rig.client() as bad:
        await bad.found("DP:valves:out:lamp")
        bad.writer.write(octets)
        async with asyncio.timeout(20):
            while await bad.reader.read(1000):
                pass
        assert (await good.timed("DP:valves:in:level"))[0] == 55.0
        assert rig.connector.dropped == 1
    assert rig.given == []


async def test_one_address_has_a_bounded_number_of_connections(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(server, "MOST_OF_ONE", 1)
    rig = Rig()
    async with rig.serving(), rig.client() as first:
        reader, writer = await asyncio.open_connection("127.0.0.1", rig.connector.port)
        assert await reader.read() == b""
        writer.close()
        assert (await first.timed("DP:valves:in:level"))[0] == 55.0


async def test_variables_that_nobody_uses_make_room_for_others(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connector, "MOST_VARIABLES", 2)
    rig = Rig()
    async with rig.serving(), rig.client() as client:
        level = await client.found("DP:valves:in:level")
        lamp = await client.found("DP:valves:out:lamp")
        assert await client.channel("DP:bus:mode") is None
        client.send(CLEAR, first=lamp.sid, second=2)
        await client.answer(CLEAR)
        assert (await client.timed("DP:bus:mode"))[0] == 3
        await client.monitor(level, 1)
        assert (await client.update(DOUBLE))[0] == 55.0


async def test_a_port_that_is_taken_and_an_address_that_is_none_are_one_line() -> None:
    rig = Rig()
    port = free_port()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", port))
        rig.connector._listen = Listen("127.0.0.1", port, "[epics] listen")
        with pytest.raises(
            PortError, match=rf"^\[epics\] listen 127.0.0.1:{port} \(UDP\): Address already in use; give"
        ):
            await rig.connector.open()
        rig.connector.close()
    with (
        socket.create_server(("127.0.0.1", port)),
        pytest.raises(PortError, match=r"^\[epics\] listen .*: Address alr"),
    ):
        await rig.connector.open()
    rig.connector.close()
    rig.connector._listen = Listen("::1", 0, "[epics] listen")
    with pytest.raises(ConfigError, match="listen '::1' has no address of IPv4"):
        await rig.connector.open()
    rig.connector.close()


async def test_beacons_go_where_the_user_says_and_else_to_this_computer_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as near,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as far,
    ):
        for one in (near, far):
            one.bind(("127.0.0.1", 0))
            one.setblocking(False)
        monkeypatch.setattr("dpstack.bridge.epics.connector.BEACON_PORT", near.getsockname()[1])
        for host, given, heard in (("127.0.0.1", [], near), ("0.0.0.0", [far.getsockname()], far)):
            rig = Rig(host=host, beacons=given)
            async with rig.serving():
                beacon = await asyncio.wait_for(asyncio.get_running_loop().sock_recv(heard, 100), 20)
                # RSRV_IS_UP: version, port, number, and the address that the reader takes from the datagram
                assert beacon[:8] == struct.pack(">HHHH", 13, 0, 13, rig.connector.port)
                assert beacon[12:] == bytes(4)
                assert any("everybody who reaches this port" in text for text in rig.told) == (host == "0.0.0.0")
        rig = Rig(host="0.0.0.0")
        async with rig.serving():
            assert isinstance(rig.connector, EpicsConnector)
            assert rig.connector._server is not None
            assert rig.connector._server.beacons == ()


async def test_a_run_that_only_reads_gives_no_rights() -> None:
    rig = Rig()
    async with rig.serving(), rig.client() as client:
        plant = {"started": STARTED, "baud": 500_000, "port": "virtual", "read_only": True, "slaves": rig.slaves}
        rig.connector.take(rig.tree.apply({"plant": plant}, rig.t))
        await rig.connector.write_changes()
        assert (await client.found("DP:valves:out:lamp")).rights == 1
        assert await client.channel("DP:hoist:cmd:start") is None
        refused = await client.put("DP:valves:out:lamp", ENUM, 1)
        assert refused.command == ERROR
    assert rig.given == []
