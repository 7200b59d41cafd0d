"""Askers: requests of one master in one data exchange have one asker, and I&M keeps the calls of each apart."""

from __future__ import annotations

from slave_kit import CFG, MASTER, PRM, UNLOCK, Bench, Recorder

from dpstack.dpv1.pdu.im import Im0, Im1
from dpstack.dpv1.pdu.read_write import Negative, ReadReq, Service, WriteReq
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.record_requests import AcyclicDevice, Asker, RecordRequest, ask, ask_records
from dpstack.dpv1.slave.record_table import ImRecords
from dpstack.dpv1.slave.resource_manager import ms2_of
from tests.dpv1.ms2_slave_kit import Later

READ = bytes.fromhex("5E 00 01 F0")
INITIATE = bytes.fromhex("57 00 00 00 00 64 01 00 00 00 00 00 00 02 00 02 00 00 00 00")


def served() -> tuple[Bench, Later]:
    device, later = Recorder(), Later()
    device.records, device.ms2 = later, 2
    made = Bench(device)
    made.prm_and_cfg(PRM + b"\x80\0\0")
    return made, later


def test_ms1() -> None:
    made, later = served()
    made.now = 11
    made.ask(51, READ)
    made.now = 22
    made.ask(51, READ)
    first, second = later.requests
    assert first.asker is second.asker
    assert (first.asker.master, first.asker.sap, first.asker.open) == (MASTER, 51, True)
    assert (first.at, second.at, first.open, second.open) == (11, 22, False, True)
    made.prm(UNLOCK)
    assert first.asker.open is False
    assert second.open is False
    made.prm_and_cfg(PRM + b"\x80\0\0", CFG)
    made.ask(51, READ)
    third = later.requests[2]
    assert third.asker is not first.asker
    assert third.asker.open is True
    third.answer(b"\1")
    third.answer(b"\2")
    second.answer(b"\3")  # too late
    assert made.ask(51).data == bytes.fromhex("5E 00 01 01 01")
    assert second.response is None


def test_ms2() -> None:
    made, later = served()
    for _ in range(2):
        made.ask(49, INITIATE, 1)
    for sap in (48, 47):
        made.ask(49, b"", 1)
        made.ask(sap, b"", 1)
        made.now += 5
        made.ask(sap, READ, 1)
    first, second = later.requests
    assert [(one.asker.master, one.asker.sap, one.asker.open, one.at) for one in (first, second)] == [
        (1, 48, True, 5), (1, 47, True, 10),
    ]  # fmt: skip
    ms2_of(made.app).abort(48, 3, made.now)
    assert (first.asker.open, first.open) == (False, False)
    assert (second.asker.open, second.open) == (True, True)
    assert [one.sap for one in ms2_of(made.app).connections] == [47]


def asked(records: ImRecords, asker: Asker, service: Service) -> str:
    request = RecordRequest(service, asker)
    records.ask(request)
    assert request.response is not None
    return request.response.build().hex()


def test_calls_of_im_belong_to_asker_and_slot() -> None:
    im = ImRecords([Im0(), Im1("x")])
    one, other = Asker(1, 51), Asker(1, 48)
    call, read = WriteReq(3, 255, bytes.fromhex("0800FDE9")), ReadReq(3, 255)
    no_call = "de80b500"
    assert asked(im, one, read) == no_call
    assert asked(im, one, call) == "5f03ff04"
    found = asked(im, one, read)
    assert found == "5e03ff44" + "0800fde9" + Im1("x").build().hex()
    assert asked(im, one, ReadReq(3, 255, 5)) == "5e03ff05" + "0800fde900"[:8] + "00"
    assert asked(im, other, read) == no_call
    assert asked(im, one, ReadReq(4, 255)) == no_call
    # what is no call ends the one before, of this slot
    assert asked(im, one, WriteReq(4, 255, b"\7")) == "df80b500"
    assert asked(im, one, read) == found
    assert asked(im, one, WriteReq(3, 255, b"\7")) == "df80b500"
    assert asked(im, one, read) == no_call
    # a refused call leaves it as it is
    asked(im, one, call)
    assert asked(im, one, WriteReq(3, 255, bytes.fromhex("0800FDEB"))) == "df80b700"
    assert asked(im, one, read) == found


def test_devices_without_anything() -> None:
    for kind in (AcyclicDevice, Device):
        assert (kind.records, kind.transport, kind.ms2_at_once) == (None, None, False)
        assert (kind.ms2, kind.ms2_max_len, kind.ms2_max_initiate) == (0, 240, 244)
    assert Device.alarm_server is None
    for call, code in (
        (lambda request: ask_records(request, None), 0xB0),
        (lambda request: ask(request, None, 0xA9), 0xA9),  # type: ignore[arg-type]
    ):
        request = RecordRequest(ReadReq(1, 2))
        call(request)  # type: ignore[no-untyped-call]
        assert request.response == Negative(0x5E, code)
        assert (request.failure, request.abandoned) == (None, None)
