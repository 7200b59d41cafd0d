"""A slave of a description and functions: its attributes, its calls, its records, its texts; mirrors of outputs."""

from __future__ import annotations

from typing import Any

import pytest
from slave_kit import PRM, Bench

from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dp.pdu.diag_blocks import UserDiag, device_block
from dpstack.dp.slave.device import Leave
from dpstack.dpv1.pdu.im import Im, Im0, Im1, Im2
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import Negative, ReadReq, WriteReq
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.loopback_device import HeldInputs, MirrorDevice, mirror_of
from dpstack.dpv1.slave.record_requests import RecordRequest
from dpstack.dpv1.slave.record_table import ByIndex, ImRecords, RecordTable
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import AlarmError, ConfigError, RecordRefused, UnknownAttribute, UsageError
from tests.dpv1.ms2_slave_kit import Later

BASE: dict[str, Any] = {"ident": 0x0A35, "name": "tank", "configs": (b"\x10\x20", b"\x11\x20")}


def echo(outputs: bytes, elapsed: int) -> bytes:
    return outputs


def slave(changes: dict[str, Any] | None = None, **options: Any) -> DpSlave:
    return DpSlave(SlaveDescription(**BASE | (changes or {})), echo, **options)


# --- from the description -------------------------------------------------------------------------------------------

ATTRIBUTES = {
    "ident": 0x0A35,
    "name": "tank",
    "configs": (b"\x10\x20", b"\x11\x20"),
    "sync_supported": True,
    "freeze_supported": True,
    "fail_safe": False,
    "fail_safe_required": False,
    "set_slave_add": False,
    "wd_base_1ms": False,
    "max_diag_len": 244,
    "alarm_server": None,
    "safe": b"",
    "on_read": None,
    "on_write": None,
    "on_transport": None,
    "ms2": 0,
    "ms2_max_len": 240,
    "ms2_max_initiate": 244,
    "records": None,
    "im": (),
    "inside": False,
    "diag": UserDiag(),
}


@pytest.mark.parametrize(
    ("changes", "options", "differs"),
    [
        ({}, {}, {}),
        ({"sync": False}, {}, {"sync_supported": False}),
        ({"freeze": False}, {}, {"freeze_supported": False}),
        ({"fail_safe": True}, {}, {"fail_safe": True}),
        ({"fail_safe_required": True}, {}, {"fail_safe": True, "fail_safe_required": True}),
        ({"set_slave_add": True}, {}, {"set_slave_add": True}),
        ({"wd_base_1ms": True}, {}, {"wd_base_1ms": True}),
        ({"max_diag_len": 33}, {}, {"max_diag_len": 33}),
        ({"ms2": 3, "ms2_max_len": 17, "ms2_max_initiate": 21}, {}, {
            "ms2": 3, "ms2_max_len": 17, "ms2_max_initiate": 21}),
        ({"ms2": 3}, {"ms2": 0}, {"ms2": 0}),
        ({}, {"ms2": 49}, {"ms2": 49}),
        ({}, {"config": bytearray(b"\x11\x20")}, {"configs": (b"\x11\x20", b"\x10\x20")}),
        ({}, {"config": None, "safe": None}, {}),
        ({}, {"safe": [7]}, {"safe": b"\7"}),
        ({}, {"on_read": echo}, {"on_read": echo}),
        ({}, {"on_write": echo}, {"on_write": echo}),
        ({}, {"on_transport": echo}, {"on_transport": echo}),
    ],
)  # fmt: skip
def test_attributes(changes: dict[str, Any], options: dict[str, Any], differs: dict[str, Any]) -> None:
    made = slave(changes, **options)
    assert {name: getattr(made, name) for name in ATTRIBUTES} == ATTRIBUTES | differs
    assert made.description == SlaveDescription(**BASE | changes)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"config": "x"}, "slave tank: config = 'x' is no octets: give bytes, "),
        ({"config": b"\x12"}, "slave tank: configuration 12 is not 10 20 or 11 20"),
        ({"safe": 5}, "slave tank: safe = 5 is no octets: give bytes, "),
        ({"safe": b"\1\2"}, "slave tank: 2 safe octets are not the outputs of every configuration"),
        ({"ms2": 50}, "slave tank: ms2 = 50: 0 to 49 class 2 connections are possible"),
        ({"ms2": True}, "slave tank: ms2 = True is no whole number: give one, "),
        ({"on_prm": 5}, "slave tank: on_prm = 5 is no function"),
        (
            {"parameters": "x"},
            "slave tank: parameters = 'x': give dpstack.profile.record47.TimedRecords",
        ),
    ],
)
def test_wrong_descriptions_are_refused(options: dict[str, Any], text: str) -> None:
    with pytest.raises(ConfigError) as refused:
        slave(**options)
    assert str(refused.value).startswith(text)
    unlike = SlaveDescription(**BASE | {"configs": (b"\x10\x20", b"\x11\x21")})
    with pytest.raises(ConfigError, match="not the outputs of every"):
        DpSlave(unlike, echo, safe=b"\1")


def test_words_for_programs() -> None:
    with pytest.raises(TypeError) as unknown:
        slave(safer=b"", colour=1)
    assert str(unknown.value) == "DpSlave() got an unexpected keyword argument 'colour'"
    with pytest.raises(ConfigError) as no_description:
        DpSlave("tank", echo)  # type: ignore[arg-type]
    assert str(no_description.value) == (
        "a DpSlave is made of a SlaveDescription, not of 'tank': SlaveDescription.simple(0x1234, inputs=2, "
        "outputs=1) for instance; slave_from_gsd(...) makes one of a GSD file"
    )
    made: Any = slave()
    with pytest.raises(ConfigError, match="on_cycle = None is no function"):
        DpSlave(made.description, None)  # type: ignore[arg-type]
    with pytest.raises(UnknownAttribute, match=r"^slave tank has no attribute 'dieg'; did you mean diag\?$"):
        made.dieg = 1
    with pytest.raises(TypeError) as wrong:
        made.diag = b"\1"
    assert str(wrong.value) == "slave tank: diag is a UserDiag, for instance UserDiag.of(device_block(b'...'))"
    diag = UserDiag.of(device_block(b"\1"))
    made.diag = diag
    assert made.diag is made.user_diag() is diag


def test_the_slave_in_the_texts_of_its_alarms() -> None:
    made = slave(
        {"dpv1": True, "alarms": ("process",), "alarm_sequence": 2, "max_diag_len": 10, "user_prm_len": (0, 3)}
    )
    server = made.alarm_server
    assert server is not None
    assert (server.support.kinds, server.support.sequence) == (frozenset({"process"}), 2)
    with pytest.raises(AlarmError, match=r"^slave tank: process alarm, slot 1"):
        server.alarm(Alarm(type=2, slot=1, specifier=0))
    with pytest.raises(UsageError, match=r"^slave tank: a block of 5 octets, its diagnosis has room for 4 "):
        server.alarm(Alarm(type=2, slot=1, specifier=0, data=b"\1"))


# --- functions of the user ------------------------------------------------------------------------------------------


def test_functions_and_their_arguments() -> None:
    calls: list[tuple[object, ...]] = []

    def note(name: str, result: object = None) -> Any:
        def function(*args: object) -> object:
            calls.append((name, made.inside, *args))
            return result

        return function

    def cycle(outputs: bytes, elapsed: int) -> bytes:
        calls.append(("cycle", made.inside, outputs, elapsed))
        return outputs

    names = ("on_prm", "on_blocks", "on_leave", "on_address", "on_initiate")
    made = DpSlave(SlaveDescription(**BASE, user_prm_len=(0, 2)), cycle, safe=b"\x0f", **{n: note(n) for n in names})
    assert made.check_prm(b"\1\2") is None
    assert made.check_prm(b"\1\2\3") == "3 octets of user parameters, 0..2 are expected"
    assert made.check_cfg(b"\x11\x20") is None
    made.enter(b"\x11\x20", 100)
    assert made.exchange(b"\x05", 130) == b"\x05"
    made.clear(150)
    made.leave(Leave.UNLOCK, 160)
    assert made.address_set(9, True, b"\7") is True
    wanted = InitiateReq(1)
    made.initiate(2, wanted)
    assert calls == [
        ("on_prm", True, b"\1\2"),
        ("on_blocks", True, ()),
        ("cycle", True, b"\x05", 30),
        ("cycle", True, b"\x0f", 50),
        ("cycle", True, b"\x0f", 60),
        ("on_leave", True, Leave.UNLOCK),
        ("on_address", True, 9, True, b"\7"),
        ("on_initiate", True, 2, wanted),
    ]
    assert made.inside is False
    assert DpSlave(made.description, cycle, on_prm=note("prm", "no")).check_prm(b"") == "no"
    assert DpSlave(made.description, cycle, on_blocks=note("blocks", "never")).check_prm(b"") == "never"


def test_without_functions() -> None:
    made = slave()
    assert made.check_prm(b"") is None
    assert made.address_set(9, False, b"") is False
    made.initiate(2, InitiateReq(1))
    made.enter(b"\x10\x21", 7)
    outputs: list[bytes] = []

    def note(octets: bytes, elapsed: int) -> bytes:
        outputs.append(octets)
        return b""

    zeros = DpSlave(made.description, note)
    zeros.enter(b"\x10\x21", 7)
    zeros.clear(8)
    assert outputs == [b"\0\0"]


def test_functions_that_raise() -> None:
    calls: list[bytes] = []

    def broken(*args: object) -> Any:
        if args and isinstance(args[0], bytes):
            calls.append(args[0])
        raise ZeroDivisionError

    made = DpSlave(SlaveDescription(**BASE), broken, on_prm=broken, safe=b"\x0f")
    made.enter(b"\x10\x20", 0)
    for call in (lambda: made.exchange(b"\1", 1), lambda: made.leave(Leave.UNLOCK, 2), lambda: made.check_prm(b"\2")):
        with pytest.raises(ZeroDivisionError):
            call()
        assert made.inside is False
    quiet = DpSlave(made.description, broken, safe=b"\x0f")
    quiet.leave(Leave.FAILURE, 3)  # its function has failed before: safe outputs all the same
    assert calls == [b"\1", b"\x0f", b"\2", b""]
    reasons: list[Leave] = []
    told = DpSlave(made.description, broken, on_leave=reasons.append)
    with pytest.raises(ZeroDivisionError):
        told.leave(Leave.WATCHDOG, 4)
    told.leave(Leave.FAILURE, 5)
    assert reasons == [Leave.FAILURE]


def test_inputs_that_the_function_goes_on_writing_to() -> None:
    image = bytearray(b"\1")
    made = DpSlave(SlaveDescription(**BASE), lambda outputs, elapsed: image)
    inputs = made.exchange(b"", 0)
    image[0] = 2
    assert inputs == b"\1"
    assert type(inputs) is bytes


# --- records --------------------------------------------------------------------------------------------------------


def ask(records: Any, service: ReadReq | WriteReq) -> str:
    """The answer in hex; "-" where nobody has answered."""
    request = RecordRequest(service)
    try:
        records.ask(request)
    except RecordRefused as error:
        request.fail(error)
    return "-" if request.response is None else request.response.build().hex()


def test_record_47_is_the_parameter_channel_and_the_others_are_those_of_the_user() -> None:
    parameters, others = RecordTable({(0, 47): b"\1"}), RecordTable({(0, 46): b"\2", (0, 47): b"\3"})
    made = slave(parameters=parameters)
    assert isinstance(made.records, ByIndex)
    assert [ask(made.records, ReadReq(0, index)) for index in (46, 47)] == ["de80b000", "5e002f0101"]
    made.serve_records(others)
    assert [ask(made.records, ReadReq(0, index)) for index in (46, 47)] == ["5e002e0102", "5e002f0101"]
    plain = slave()
    plain.serve_records(others)
    assert plain.records is others


def test_identification_beside_the_other_records() -> None:
    written: list[tuple[int, Im]] = []
    made = slave(im=iter([Im0(order_id="X"), Im2("then")]), on_im=lambda slot, im: written.append((slot, im)))
    assert made.im == made.im_of(0) == made.im_of(7) == (Im0(order_id="X", supported=4), Im2("then"))
    assert isinstance(made.records, ImRecords)
    assert ask(made.records, ReadReq(0, 1)) == "de80b000"
    assert ask(made.records, ReadReq(0, 255)) == "de80b500"  # no call before
    made.serve_records(RecordTable({(0, 1): b"\5"}))
    assert ask(made.records, ReadReq(0, 1)) == "5e00010105"
    assert ask(made.records, WriteReq(3, 255, bytes.fromhex("0800fdea") + Im2("now").build())) == "5f03ff44"
    assert written == [(3, Im2("now"))]
    assert made.im[1] == Im2("now")
    by_slot = slave(im={2: [Im1("a")]})
    assert (by_slot.im, by_slot.im_of(2)) == ((), (Im0(supported=2), Im1("a")))

    def refuse(slot: int, im: Im) -> None:
        raise RecordRefused(0xB6, 3)

    locked = slave(im=[Im0(), Im2("then")], on_im=refuse)
    assert ask(locked.records, WriteReq(0, 255, bytes.fromhex("0800fdea") + Im2("now").build())) == "df80b603"
    assert locked.im[1] == Im2("then")


def test_both_on_the_bus() -> None:
    made = slave({"dpv1": True}, parameters=RecordTable({(0, 47): b"\1"}), im=[Im0()])
    later = Later()
    made.serve_records(later)
    bench = Bench(made)
    bench.prm_and_cfg(PRM + b"\x80\0\0", b"\x10\x20")
    for request, answer in (
        ("5E 00 2F F0", "5e002f0101"),
        ("5F 00 FF 04 08 00 FD E8", "5f00ff04"),
        ("5E 00 05 F0", ""),
    ):
        bench.ask(51, bytes.fromhex(request))
        assert bench.ask(51).data.hex() == answer
    assert [request.service for request in later.requests] == [ReadReq(0, 5)]


@pytest.mark.parametrize("late", [False, True])
def test_a_request_that_nobody_wants_any_more_has_no_failure(late: bool) -> None:
    request = RecordRequest(WriteReq(1, 2, b"\1"))
    told: list[str] = []
    request.abandoned = lambda: told.append("abandoned")
    if late:
        request.drop()
    request.fail(ZeroDivisionError("x"))
    assert told == (["abandoned"] if late else [])
    assert request.response == (None if late else Negative(0x5F, 0xA1))
    assert (request.failure is None) is late
    request.drop()
    assert request.open is False


# --- mirrors --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("config", "outputs", "inputs"),
    [
        (b"\x10\x20", "55", "55"),
        (b"\x11\x20", "55", "5500"),
        (b"\x10\x21", "5566", "55"),
        (b"\x20", "55", ""),
        (b"\x11", "", "0000"),
    ],
)
def test_a_mirror_gives_its_outputs_in_the_length_of_its_inputs(config: bytes, outputs: str, inputs: str) -> None:
    described = SlaveDescription(ident=0x1234, name="glass", configs=(config,), fail_safe=True)
    for made in (mirror_of(described), MirrorDevice(0x1234, config)):
        made.enter(config, 0)
        assert made.exchange(bytes.fromhex(outputs), 5).hex() == inputs
    assert (mirror_of(described).name, mirror_of(described).description) == ("glass", described)


def test_a_mirror_whose_inputs_are_set_from_outside() -> None:
    described = SlaveDescription(ident=0x1234, configs=(b"\x10\x20",))
    held = HeldInputs(1)
    mirrors = (mirror_of(described, held), MirrorDevice(0x1234, b"\x10\x20", held=held))
    for octets in (b"\xaa", None):
        held.octets = octets
        assert [made.exchange(b"\x55", 5) for made in mirrors] == [octets or b"\x55"] * 2


def test_a_mirror_s_attributes() -> None:
    made = MirrorDevice(0x1234, b"\x10\x20")
    assert (made.ident, made.configs, made.name, made.fail_safe) == (0x1234, (b"\x10\x20",), "mirror", False)
    assert MirrorDevice.set_slave_add is True
    other = MirrorDevice(1, b"\x10", "x", fail_safe=True)
    assert (other.name, other.fail_safe) == ("x", True)
    with pytest.raises(ConfigError):
        MirrorDevice(1, b"\x80")
