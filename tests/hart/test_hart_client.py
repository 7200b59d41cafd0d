"""The master's end of HART records against a simulated module, and against anything: no bus, a clock of integers."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from typing import TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.dpv1.pdu.read_write import ReadReq, WriteReq
from dpstack.hart.client import HartClient, HartClientError, Pause, Refused, Transport
from dpstack.hart.commands import Identity
from dpstack.hart.module import FAULTS, HartModule
from dpstack.hart.reading import read_out
from dpstack.hart.records import Result, build_response
from dpstack.hart.telegram import Answer
from dpstack.hart.transmitter import pressure, temperature
from dpstack.units import NS_PER_MS, NS_PER_S

T = TypeVar("T")
#: a Read or Write takes so long
SERVICE = 10 * NS_PER_MS
SLOT = 2


class Rig:
    """A module with two transmitters and the time; ``before`` changes or answers a service instead of the module."""

    def __init__(self, before: Callable[[ReadReq | WriteReq], bytes | Refused | None] = lambda _: None) -> None:
        self.module = HartModule((pressure(), temperature()))
        self.module.transmitters[0].percent = 50.0
        self.before = before
        self.now = NS_PER_S
        self.services: list[ReadReq | WriteReq] = []

    def service(self, one: ReadReq | WriteReq) -> bytes | Refused:
        self.now += SERVICE
        self.services.append(one)
        instead = self.before(one)
        if instead is not None:
            return instead
        if one.slot != SLOT:
            return Refused(Code.INVALID_INDEX, "invalid index")
        if isinstance(one, WriteReq):
            found: bytes | Code = self.module.write(one.index, one.data, self.now) or b""
        else:
            found = self.module.read(one.index, self.now)
        return Refused(found, found.name) if isinstance(found, Code) else found

    def run(self, transport: Transport[T]) -> T:
        step: tuple[int, bytes | Refused] | None = None
        try:
            while True:
                service = next(transport) if step is None else transport.send(step)
                if isinstance(service, Pause):
                    self.now += service.ns
                    step = self.now, b""
                else:
                    found = self.service(service)
                    step = self.now, found
        except StopIteration as end:
            result: T = end.value
            return result

    def command(
        self, number: int, data: bytes = b"", *, channel: int = 0, compact: bool = False, seconds: int = 20
    ) -> Answer:
        return self.run(self.client(channel, compact).command(number, data, deadline=self.now + seconds * NS_PER_S))

    def client(self, channel: int = 0, compact: bool = False) -> HartClient:
        self.made = HartClient(SLOT, channel, compact=compact)
        return self.made

    @property
    def indexes(self) -> list[int]:
        """The records that were asked, repetitions left out."""
        asked = [one.index for one in self.services]
        return [index for at, index in enumerate(asked) if at == 0 or asked[at - 1] != index]


def test_the_records_of_a_command() -> None:
    rig = Rig()
    answer = rig.command(3)
    assert answer.data[:9] == bytes.fromhex("41400000 07 40A00000")
    assert rig.indexes == [148, 149, 80, 81, 80, 81]  # directory, features, command 0, command 3
    assert rig.made.counters.requests == 2
    assert rig.made.counters.not_yet > 2
    writes = [one.data.hex() for one in rig.services if isinstance(one, WriteReq)]
    assert writes == ["00ff0280000082", "00ff82bd0101020303003d"]


def test_the_second_channel_and_the_compact_format() -> None:
    rig = Rig()
    assert rig.command(1, channel=1, compact=True).data == bytes.fromhex("20 C2480000")  # -50 °C: 0 %
    assert rig.indexes == [148, 149, 82, 83]  # no identity: the module knows the address
    assert [one.data.hex() for one in rig.services if isinstance(one, WriteReq)] == ["20ff0100"]


def test_a_module_says_not_yet_by_its_result_and_by_a_denied_read() -> None:
    rig = Rig()
    rig.module.set_fault(0, "denied", 4)
    assert rig.command(1).response_code == 0
    assert rig.made.counters.not_yet >= 4


@pytest.mark.parametrize("fault", ["slow 3", "busy 2", "delayed", "damaged 2", "garbled 2", "denied"])
def test_faults_that_pass(fault: str) -> None:
    rig = Rig()
    client = rig.client()
    rig.run(client.read_identity(deadline=rig.now + 20 * NS_PER_S))
    name, *value = fault.split()
    rig.module.set_fault(0, name, float(value[0]) if value else None)
    answer = rig.run(client.command(1, deadline=rig.now + 20 * NS_PER_S))
    assert answer.data == bytes.fromhex("07 40A00000")
    counters = client.counters
    assert counters.busy == {"busy": 2, "delayed": 3}.get(name, 0)
    assert counters.damaged == (2 if name in ("damaged", "garbled") else 0)


@pytest.mark.parametrize(
    ("fault", "reason", "text"),
    [
        ("slow 60", "timeout", "the module has no answer yet: the request is being carried out"),
        ("busy", "timeout", "the device is still busy (busy)"),
        ("damaged", "module", "a damaged answer, or none: checksum error, tried 3 times"),
        ("garbled", "damaged", "is expected, tried 3 times"),
        ("silent", "module", "no answer in time, tried 3 times"),
    ],
)
def test_faults_that_stay(fault: str, reason: str, text: str) -> None:
    rig = Rig()
    name, *value = fault.split()
    rig.module.set_fault(0, name, float(value[0]) if value else None)
    begun = rig.now
    with pytest.raises(HartClientError) as raised:
        rig.command(1)
    assert raised.value.reason == reason
    assert text in raised.value.text
    assert raised.value.text.startswith("slot 2, channel 0: ")
    assert rig.now - begun <= 25 * NS_PER_S
    rig.now += 60 * NS_PER_S
    rig.module.set_fault(0, "well")
    assert rig.command(1).response_code == 0  # nothing of it is left
    assert rig.command(1, channel=1).response_code == 0


def test_a_command_that_writes_is_not_sent_again_after_a_damaged_answer() -> None:
    rig = Rig()
    client = rig.client()
    deadline = rig.now + 20 * NS_PER_S
    rig.run(client.read_identity(deadline=deadline))
    rig.module.set_fault(0, "garbled")
    before = client.counters.requests
    with pytest.raises(HartClientError, match="may have carried it out: read it back"):
        rig.run(client.command(34, bytes.fromhex("40000000"), deadline=deadline))
    assert client.counters.requests == before + 1


def test_a_broken_wire_and_the_address_of_another_device() -> None:
    rig = Rig()
    rig.module.broken = frozenset({0})
    with pytest.raises(HartClientError, match="open line"):
        rig.command(1)
    rig.module.broken = frozenset()
    client = rig.client()
    client.identity = Identity.parse(bytes.fromhex("FE 15 02 05 05 03 0F 10 00 0D 91 43"))
    with pytest.raises(HartClientError, match="no answer in time"):
        rig.run(client.command(1, deadline=rig.now + 20 * NS_PER_S))


def test_no_module_no_channel_no_compact_format() -> None:
    rig = Rig()
    with pytest.raises(HartClientError, match=r"^slot 3 has no HART module \(record 148: invalid index\)$") as raised:
        rig.run(HartClient(3, 0).open())
    assert raised.value.reason == "absent"
    with pytest.raises(HartClientError, match="slot 2 has the HART channels 0 to 1, no channel 2") as raised:
        rig.run(HartClient(2, 2).open())
    assert raised.value.reason == "channel"
    rig = Rig(lambda one: bytes(3) if one.index == 149 else None)
    with pytest.raises(HartClientError, match="does not support the compact format"):
        rig.command(1, compact=True)


def test_a_refusal_of_the_device() -> None:
    rig = Rig()
    with pytest.raises(
        HartClientError, match=r"refuses command 99: command not implemented \(response code 64\)"
    ) as err:
        rig.command(99)
    assert (err.value.reason, err.value.response_code) == ("refused", 64)


def test_a_request_that_the_module_does_not_take() -> None:
    rig = Rig(lambda one: bytes((0, 0, 75)) if one.index == 149 else None)
    with pytest.raises(HartClientError, match="a request of 111 octets, the module takes 75"):
        rig.command(17, bytes(100))
    with pytest.raises(HartClientError, match="256 octets of data"):
        rig.command(17, bytes(256))


def test_a_module_that_is_busy_with_the_request_of_another_program() -> None:
    """The request of the other one is under way: ours is refused until it is over."""
    rig = Rig()
    assert rig.module.write(80, bytes.fromhex("00ff0280000082"), rig.now) is None
    assert rig.command(1).response_code == 0
    rig.module.set_fault(0, "slow", 60.0)
    assert rig.module.write(80, bytes.fromhex("00ff0280000082"), rig.now) is None
    with pytest.raises(HartClientError, match="still busy with another request: RESOURCE_BUSY"):
        rig.command(1, seconds=5)


def test_answers_to_the_requests_of_others_are_not_taken_for_ours() -> None:
    other = build_response(Result.SUCCESS, telegram=bytes.fromhex("86 A6 06 BC 61 4E 01 07 00 00 06 40 B0 00 00 45"))
    left = 2

    def before(one: ReadReq | WriteReq) -> bytes | None:
        nonlocal left
        if one.index == 81 and rig.made.identity is not None and left:
            left -= 1
            return other
        return None

    rig = Rig(before)
    assert rig.command(1).data == bytes.fromhex("07 40A00000")
    assert rig.made.counters.strays == 2


def test_a_request_that_the_module_has_lost() -> None:
    lost = build_response(Result.INACTIVE)
    rig = Rig(lambda one: lost if one.index == 81 else None)
    with pytest.raises(HartClientError, match=r"the module has lost the request, .* tried 3 times"):
        rig.command(1)


@pytest.mark.parametrize(
    ("directory", "why"),
    [
        ("", "its head has 9"),
        ("0200FF0101C895FFFF8350", r"points outside"),
        ("0200FF01FF0195FFFF50", "for 255 channels"),
    ],
)
def test_directories_that_lie(directory: str, why: str) -> None:
    octets = bytes.fromhex(directory)
    rig = Rig(lambda one: octets if one.index == 148 else None)
    with pytest.raises(HartClientError, match=why) as raised:
        rig.command(1)
    assert raised.value.reason == "damaged"


@given(st.lists(st.binary(max_size=40), min_size=1, max_size=8), st.sampled_from([0, 1, 3, 48]))
def test_a_module_that_answers_anything(records: list[bytes], number: int) -> None:
    """Each command ends, with an answer or one error, and the client polls no longer than its deadline allows."""
    at = 0

    def before(one: ReadReq | WriteReq) -> bytes | None:
        nonlocal at
        if one.index != 81:
            return None
        at += 1
        return records[at % len(records)]

    rig = Rig(before)
    begun = rig.now
    with contextlib.suppress(HartClientError):
        rig.command(number, seconds=5)
    assert rig.now - begun < 20 * NS_PER_S


@given(st.binary(max_size=40), st.binary(max_size=5))
def test_a_directory_of_any_octets(directory: bytes, features: bytes) -> None:
    rig = Rig(lambda one: {148: directory, 149: features}.get(one.index))
    with contextlib.suppress(HartClientError):
        rig.command(1, seconds=2)


def test_all_that_a_transmitter_says_of_itself() -> None:
    rig = Rig()

    def deadline() -> int:
        return rig.now + 20 * NS_PER_S

    reading = rig.run(read_out(rig.client(0), deadline))
    assert dict(reading.rows) | {"PV": "5 bar"} == dict(reading.rows)
    assert reading.device_status == ("cold start",)
    assert reading.refused == {}
    shown = reading.as_dict()
    assert shown["current_ma"] == 12.0
    assert shown["long_tag"] == "PT-101"
    again = rig.run(read_out(rig.client(0), deadline))
    assert again.device_status == ()
    rig.module.set_status(0, 0x80)
    assert "electronic defect" in (rig.run(read_out(rig.client(0), deadline)).additional_status or ())
    old = rig.run(read_out(rig.client(1), deadline))
    assert (old.long_tag, old.identity.revision) == (None, 5)
    assert [label for label, _ in old.rows][:3] == ["tag", "descriptor", "date"]


def test_a_device_that_refuses_what_others_have() -> None:
    rig = Rig()
    transmitter = rig.module.transmitters[0]
    known = transmitter.reply
    transmitter.reply = lambda command, data: b"\x40\x00" if command in (13, 48) else known(command, data)  # type: ignore[method-assign]
    reading = rig.run(read_out(rig.client(0), lambda: rig.now + 20 * NS_PER_S))
    assert reading.tag is None
    assert reading.additional_status is None
    assert set(reading.refused) == {13, 48}
    assert ("command 13", reading.refused[13]) in reading.rows


@pytest.mark.parametrize("compact", [False, True])
def test_a_transmitter_that_is_exchanged(compact: bool) -> None:
    """Its address is another one: no value of the new device is shown as one of the old, and the next call finds it."""
    rig = Rig()
    client = rig.client(compact=compact)
    first = rig.run(read_out(client, lambda: rig.now + 20 * NS_PER_S))
    rig.module.transmitters[0].device_id += 1
    why = "another device answers: 3D 01 01 02 04, before it was 3D 01 01 02 03" if compact else "no answer in time"
    with pytest.raises(HartClientError, match=why):
        rig.run(client.command(1, deadline=rig.now + 20 * NS_PER_S))
    assert rig.run(client.command(1, deadline=rig.now + 20 * NS_PER_S)).response_code == 0
    rig.module.transmitters[0].device_id += 1
    second = rig.run(read_out(client, lambda: rig.now + 20 * NS_PER_S))
    assert second.identity.device_id == first.identity.device_id + 2


def test_ranges_and_tags_are_written_and_read_back() -> None:
    rig = Rig()
    assert rig.command(35, bytes.fromhex("07 41A00000 00000000")).response_code == 0
    assert rig.command(15).data[3:11] == bytes.fromhex("41A00000 00000000")
    answer = rig.command(1)
    assert answer.data == bytes.fromhex("07 41200000")  # half of 20 bar
    assert "configuration changed" in answer.device_status_texts
    for data, text in (("20 41A00000 00000000", "invalid units code"), ("07 00000000 00000000", "invalid span")):
        with pytest.raises(HartClientError, match=text):
            rig.command(35, bytes.fromhex(data))
    with pytest.raises(HartClientError, match="too few data bytes"):
        rig.command(18, b"\0")
    rig.command(38)
    assert rig.command(1).device_status_texts == ()


def test_faults_of_a_channel_are_checked() -> None:
    module = HartModule((pressure(),))
    for number, fault, value, why in (
        (1, "busy", None, "there is no HART channel 1; there are 0 to 0"),
        (0, "bussy", None, "did you mean busy"),
        (0, "busy", 1.5, "a whole number of requests"),
        (0, "slow", 1e9, "up to 3600"),
    ):
        with pytest.raises(ValueError, match=why):
            module.set_fault(number, fault, value)
    with pytest.raises(ValueError, match="no device status octet"):
        module.set_status(0, 0x100)
    assert module.faults == {}
    for fault in FAULTS:
        module.set_fault(0, fault)
    assert module.faults == {0: "denied"}
    module.set_fault(0, "slow", 2.5)
    assert module.faults == {0: "slow 2.5"}


@given(st.binary(max_size=60), st.integers(78, 150), st.booleans())
def test_a_module_takes_any_octets(data: bytes, index: int, read: bool) -> None:
    module = HartModule((pressure(), temperature()))
    found = module.read(index, 0) if read else module.write(index, data, 0)
    assert found is None or isinstance(found, (bytes, Code))
    if module.has(81):
        module.read(81, NS_PER_S)
