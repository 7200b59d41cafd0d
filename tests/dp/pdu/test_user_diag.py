"""The diagnosis that an application sets: blocks octet by octet, when it is fetched, what a lost answer does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from octet_wire import PARAMS, Wire, framed
from slave_kit import CFG, MASTER, SLAVE, Bench, make_slave

from dpstack.dp.pdu.diag_blocks import (
    NO_DIAG,
    Block,
    UserDiag,
    channel_block,
    device_block,
    identifier_block,
    revision_block,
    split_blocks,
)
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.errors import PduError
from dpstack.fdl.telegram import Kind, Resp, Telegram


def slave(**more: Any) -> DpSlave:
    description = SlaveDescription(ident=0x0A35, configs=(CFG,), name="own", **more)
    return DpSlave(description, lambda outputs, elapsed: outputs)


def saying(diag: UserDiag, **more: Any) -> tuple[DpSlave, Bench]:
    """A slave in data exchange whose application sets ``diag`` then."""
    device = slave(**more)
    bench = Bench(device).up()
    device.diag = diag
    return device, bench


# --- blocks (docs/reference/protocol.md#diagnosis-blocks)
# ---------------------------------------------------------------------


@pytest.mark.parametrize(
    ("block", "octets"),
    [
        (device_block(b"\x12\x34"), "03 12 34"),
        (device_block(bytes(62)), "3F" + " 00" * 62),
        (identifier_block([0, 3], 6), "42 09"),
        (identifier_block([8], 9), "43 00 01"),
        (identifier_block([], 1), "42 00"),
        (channel_block(2, 5, 6, size=1, input=True), "82 45 26"),  # module 2, input channel 5, bit: line break
        (channel_block(63, 63, 31, size=7, input=True, output=True), "BF FF FF"),
        (channel_block(0, 1, 1, output=True), "80 81 01"),
        (revision_block(5), "C5"),
    ],
)
def test_blocks(block: Block, octets: str) -> None:
    wanted = bytes.fromhex(octets)
    assert block.octets == wanted
    assert split_blocks(wanted) == ((block,), None)  # read back, it is the same


@pytest.mark.parametrize(
    ("make", "text"),
    [
        (lambda: device_block(b""), "0 octets; 1..62"),
        (lambda: device_block(bytes(63)), "63 octets; 1..62"),
        (lambda: identifier_block([6], 6), "module 6 of 6"),
        (lambda: identifier_block([-1], 6), "module -1"),
        (lambda: identifier_block([], 0), "0 octets"),
        (lambda: channel_block(64, 0, 1), "identifier = 64"),
        (lambda: channel_block(0, 64, 1), "channel = 64"),
        (lambda: channel_block(0, 0, 32), "error = 32"),
        (lambda: channel_block(0, 0, 1, size=8), "size = 8"),
        (lambda: revision_block(64), "value = 64"),
    ],
)
def test_values_that_do_not_fit_a_block(make: Callable[[], Block], text: str) -> None:
    with pytest.raises(PduError, match=text):
        make()


@given(
    st.lists(
        st.one_of(
            st.binary(min_size=1, max_size=62).map(device_block),
            st.integers(1, 400).flatmap(
                lambda n: st.lists(st.integers(0, n - 1), max_size=9).map(lambda faulty: identifier_block(faulty, n))
            ),
            st.builds(
                channel_block,
                st.integers(0, 63),
                st.integers(0, 63),
                st.integers(0, 31),
                size=st.integers(0, 7),
                input=st.booleans(),
                output=st.booleans(),
            ),
            st.integers(0, 63).map(revision_block),
        ),
        max_size=12,
    ),
    st.integers(0, 238),
)
def test_any_blocks_come_back_and_are_cut_between_blocks(blocks: list[Block], room: int) -> None:
    diag = UserDiag.of(*blocks)
    assert split_blocks(diag.ext) == (tuple(blocks), None)
    cut = diag.limited(room)
    kept, finding = split_blocks(cut.ext)
    assert finding is None
    assert kept == tuple(blocks)[: len(kept)]
    assert len(cut.ext) <= room
    assert cut.overflow is (len(diag.ext) > room)


# --- in the slave's diagnosis -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("diag", "octets"),
    [
        (NO_DIAG, "00 0C 00 02 0A 35"),
        (UserDiag.of(device_block(b"\x01")), "08 0C 00 02 0A 35 02 01"),
        (UserDiag.of(device_block(b"\x01"), fault=False), "00 0C 00 02 0A 35 02 01"),  # a mere message
        (UserDiag.of(stat=True), "00 0E 00 02 0A 35"),
        (UserDiag.of(fault=True), "08 0C 00 02 0A 35"),
        (UserDiag.of(revision_block(1), stat=True, overflow=True), "08 0E 80 02 0A 35 C1"),
        (
            UserDiag.of(device_block(b"\x01"), identifier_block([1], 8), channel_block(1, 0, 6, input=True)),
            "08 0C 00 02 0A 35 02 01 42 02 81 40 06",
        ),
    ],
)
def test_the_diagnosis_set_is_the_diagnosis_read(diag: UserDiag, octets: str) -> None:
    _, bench = saying(diag)
    assert bench.diag() == bytes.fromhex(octets)
    assert bench.app.diagnosis(0).build() == bytes.fromhex(octets)


@pytest.mark.parametrize("diag", [UserDiag.of(stat=True), UserDiag.of(fault=True), UserDiag.of(overflow=True)])
def test_every_change_is_fetched(diag: UserDiag) -> None:
    device = slave()
    bench = Bench(device).up()
    assert bench.dx().status is Resp.DL
    for present in (diag, NO_DIAG):
        device.diag = present
        assert [bench.dx().status, bench.dx().status] == [Resp.DH, Resp.DH]
        bench.diag()
        assert bench.dx().status is Resp.DL


def test_a_diagnosis_taken_back_before_the_master_read_it_is_not_fetched() -> None:
    device, bench = saying(UserDiag.of(stat=True))
    assert bench.dx().status is Resp.DH
    device.diag = NO_DIAG
    assert bench.dx().status is Resp.DL


@pytest.mark.parametrize(("room", "octets"), [(6, ""), (7, ""), (8, "02 01"), (10, "02 01"), (11, "02 01 81 40 06")])
def test_more_than_max_diag_data_len_overflows_between_blocks(room: int, octets: str) -> None:
    """Blocks are left out as a whole: a block cut short would announce a wrong length."""
    blocks = (device_block(b"\x01"), channel_block(1, 0, 6, input=True), revision_block(3))
    _, bench = saying(UserDiag.of(*blocks), max_diag_len=room)
    assert bench.diag() == bytes.fromhex("08 0C 80 02 0A 35" + octets)


def test_diag_is_set_as_a_whole_or_not_at_all() -> None:
    device = slave()
    wrong: Any = b"\x02\x01"
    with pytest.raises(TypeError, match="diag is a UserDiag"):
        device.diag = wrong
    wrong = "no octets"
    with pytest.raises(TypeError, match="bytes, not str"):
        UserDiag(wrong)
    assert device.diag is NO_DIAG


# --- lost answers -------------------------------------------------------------------------------------------------


#: requests as (function code, DSAP): Data_Exchange, Slave_Diag, Get_Cfg; each answer of Data_Exchange tells whether the
#: master has still to read the diagnosis. FCV 0, FCB 1 after Slave_Diag: every attempt to get it failed
#: (docs/reference/protocol.md#frame-count-bit).
@pytest.mark.parametrize(
    "requests",
    [
        pytest.param([(0x5D, None, Resp.DH), (0x7D, 60, None), (0x5D, None, Resp.DL)], id="goes on: has read it"),
        pytest.param(
            [(0x7D, 60, None), (0x6D, None, Resp.DH), (0x7D, 60, None), (0x5D, None, Resp.DL)],
            id="takes the station up afresh: has not",
        ),
        pytest.param(
            [(0x7D, 60, None), (0x6D, 59, None), (0x5D, None, Resp.DH), (0x7D, 60, None), (0x5D, None, Resp.DL)],
            id="takes the station up afresh with another service: has not",
        ),
    ],
)
def test_whether_the_master_has_read_it(requests: list[tuple[int, int | None, Resp | None]]) -> None:
    _, bench = saying(UserDiag.of(device_block(b"\x01")))
    for fc, dsap, status in requests:
        data, ssap = (b"\1", None) if dsap is None else (b"", 62)
        reply = bench.app.serve(Telegram(Kind.SD2, SLAVE, MASTER, fc, dsap, ssap, data), 0)
        assert reply is not None
        assert status in (None, reply.status)


def test_a_repeated_request_gets_the_same_diagnosis_again_on_the_wire() -> None:
    """The answer was lost; meanwhile the application says something else: that is fetched after it, neither lost nor
    doubled."""
    device = slave()
    wire = Wire(make_slave(8, device, PARAMS))
    wire.ask(framed(0x88, 0x82, 0x6D, "3D 3E 80 01 01 0B 0A 35 00"))
    wire.ask(framed(0x88, 0x82, 0x5D, "3E 3E 10 20"))
    device.diag = UserDiag.of(device_block(b"\x01"))
    assert wire.ask("68 04 04 68 08 02 7D 55 DC 16") == "68 04 04 68 02 08 0A 55 69 16"  # DH
    first = wire.ask(framed(0x88, 0x82, 0x5D, "3C 3E"))
    assert first == framed(0x82, 0x88, 0x08, "3E 3C 08 04 00 02 0A 35 02 01").upper()
    device.diag = UserDiag.of(device_block(b"\x02"))
    assert wire.ask(framed(0x88, 0x82, 0x5D, "3C 3E")) == first
    assert wire.ask("68 04 04 68 08 02 7D 55 DC 16") == "68 04 04 68 02 08 0A 55 69 16"  # DH: the second one
    second = wire.ask(framed(0x88, 0x82, 0x5D, "3C 3E"))
    assert second == framed(0x82, 0x88, 0x08, "3E 3C 08 04 00 02 0A 35 02 02").upper()
    assert wire.ask("68 04 04 68 08 02 7D 55 DC 16") == "68 04 04 68 02 08 08 55 67 16"  # DL


def test_a_device_that_returns_no_diagnosis_fails_alone() -> None:
    class Lies(DpSlave):
        def user_diag(self) -> Any:
            return "ill"

    bench = Bench(Lies(SlaveDescription(ident=0x0A35, configs=(CFG,)), lambda outputs, elapsed: outputs))
    assert isinstance(bench.app, SlaveApp)
    assert bench.diag()[:2] == b"\x02\x07"
    assert bench.app.failure == "TypeError: user_diag() returned str, a UserDiag is wanted"
