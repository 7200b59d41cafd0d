"""Recorded telegrams of real devices, played at both ends: a recorded slave before our master, a recorded master before
our slave, and all of them before the decoder and the describer.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from octet_slave import sd1
from octet_wire import PARAMS, Wire
from recordings import (
    ASM754,
    FESTO_CPV,
    FESTO_RS,
    IM151,
    IM151_PLC,
    LOGO_TD,
    TI_SITARA,
    TOIT,
    WHOLE,
    Recording,
    completed,
    is_to,
)
from ring_bus import RingBus
from slave_kit import make_slave

from dpstack.decode.words import describe_octets
from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.master import Master
from dpstack.dp.pdu.diag_blocks import DeviceBlock, IdentifierBlock
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave_params import SlaveParams
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.dpv1.slave.record_table import RecordTable
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.commands import GoOnline
from dpstack.fdl.decoder import Decoder
from dpstack.params import BusParams

MS = 1_000_000
DIAG, PRM, CFG = 60, 61, 62
BY_NAME = {recording.name: recording for recording in WHOLE}


# --- the decoder and the describer ---


@pytest.mark.parametrize("name", BY_NAME)
def test_the_decoder_finds_every_recorded_telegram_octet_by_octet(name: str) -> None:
    decoder = Decoder(stall_ns=MS)
    for _, octets in BY_NAME[name].lines:
        found = [telegram for octet in octets for telegram in decoder.feed(bytes((octet,)), 0)]
        assert len(found) == 1
    assert decoder.stats.bad == decoder.stats.skipped == 0


@pytest.mark.parametrize(
    ("recording", "line", "text"),
    [
        (IM151_PLC, 0, "Global_Control 1 -> all, Operate, all groups (SDN high)"),
        (IM151_PLC, 3, "Get_Cfg request 1 -> 8 (SRD high, FCV=1 FCB=0)"),
        (IM151_PLC, 5, "Set_Prm request 1 -> 8, 32 octets (SRD high, FCV=1 FCB=1)"),
        (IM151, 3, "Slave_Diag answer 5 -> 2, 35 octets: module status: all modules ok (DL, slave)"),
        (TI_SITARA, 0, "FDL_Status request 99 -> 2 (FC 0x49)"),
        (TOIT, 4, "Data_Exchange request 2 -> 20, 1 octet (SRD high, FCV=0 FCB=1)"),
        (ASM754, 10, "MS1 request 2 -> 3, 10 octets: Write of slot 1, index 104, data 6 (SRD low, FCV=1 FCB=0)"),
        (ASM754, 19, "MS1 answer 3 -> 2, 10 octets: Read of slot 1, index 104, data 6 (DL, slave)"),
    ],
)
def test_recorded_telegrams_in_words(recording: Recording, line: int, text: str) -> None:
    octets = recording.lines[line][1]
    assert describe_octets(completed(octets) if recording is ASM754 else octets) == text


def test_telegrams_of_a_logo_text_display_are_no_profibus() -> None:
    """These telegrams begin as SD2 telegrams do, and their checksum is right; the length does not fit."""
    decoder = Decoder(stall_ns=MS)
    for number, octets in enumerate(LOGO_TD):
        assert not decoder.feed(octets, number * 10 * MS)
        assert not decoder.stalled(number * 10 * MS + 5 * MS)
    assert decoder.stats.telegrams == 0
    assert decoder.stats.le_range == len(LOGO_TD)


def test_the_diagnosis_of_an_im151_to_the_bit() -> None:
    answers = [answer for request, answer in IM151_PLC.pairs if is_to(request, DIAG)]
    first, second, last = (Diagnosis.parse(answers[i][9:-2]) for i in (0, 1, -1))
    assert first is not None
    assert second is not None
    assert last is not None
    assert first.flags == ("station_not_ready", "prm_req")
    assert (first.ident, first.master, first.blocks) == (0x80E0, None, ())
    assert (second.flags, last.flags) == (("stat_diag", "wd_on"), ("wd_on",))
    assert last.master == 1
    identifiers, status = last.blocks
    assert isinstance(identifiers, IdentifierBlock)
    assert isinstance(status, DeviceBlock)
    # 0x49: nine octets with the header, a bit for each of 64 modules; 0x14: twenty octets, 0x82: module status
    assert identifiers.modules == ()
    assert status.data == bytes.fromhex("82") + bytes(18)
    assert last.ext_finding is None


# --- a recorded slave before our master ---


@dataclass
class RecordedSlave:
    """Gives the recorded answers to each service: to Slave_Diag its first one until Set_Prm, then the others in their
    order, the last one (``ready``, where that is given) for ever; FDL status also where the recording has none.
    It answers Data_Exchange with ``exchange``.
    """

    recording: Recording
    exchange: bytes
    ready: bytes = b""
    requests: list[bytes] = field(default_factory=list)
    left: list[bytes] | None = None

    def __call__(self, octets: bytes, now: int) -> tuple[int, bytes] | None:
        self.requests.append(octets)
        if octets[0] == 0x10 and octets[3] == 0x49:
            return 11, sd1(self.recording.master, self.recording.slave, 0x00)
        if octets[0] == 0x68 and octets[4] & 0x80:
            answer = self.answer(octets[7])
            return None if answer is None else (11, answer)
        return 11, self.exchange

    def answer(self, dsap: int) -> bytes | None:
        answers = [answer for request, answer in self.recording.pairs if is_to(request, dsap)]
        if dsap == DIAG and self.left is not None:
            return self.left.pop(0) if len(self.left) > 1 else self.left[0]
        if dsap == PRM:
            diagnoses = [answer for request, answer in self.recording.pairs if is_to(request, DIAG)]
            self.left = diagnoses[1:] + ([self.ready] if self.ready else [])
        return answers[0] if answers else None

    def restart(self) -> None:
        """The slave wants parameters again."""
        self.left = None

    def to(self, dsap: int) -> list[bytes]:
        return [octets[9:-2] for octets in self.requests if is_to(octets, dsap)]

    def count(self, dsap: int) -> int:
        return len(self.to(dsap))

    @property
    def exchanges(self) -> int:
        return sum(octets[0] == 0x68 and not octets[4] & 0x80 for octets in self.requests) + sum(
            octets[0] == 0x10 and octets[3] != 0x49 for octets in self.requests
        )


class Brought:
    """Our master at the recorded master's address, before one recorded slave."""

    def __init__(self, setup: SlaveParams, slave: RecordedSlave) -> None:
        self.slave = slave
        self.bus = RingBus(500_000, "octets")
        self.bus.slaves[setup.address] = slave
        params = BusParams.preset(500_000, address=slave.recording.master, gap=0)
        self.master = Master(params, [setup])
        self.station = ActiveStation(params, [self.master])
        self.bus.stations.append(self.station)
        self.bus.command(self.station, GoOnline())
        self.bus.command(self.station, SetMode(Mode.OPERATE))
        self.handler = self.master.handlers[setup.address]

    def until(self, state: SlaveState, within_ms: int = 2_000) -> None:
        for _ in range(within_ms):
            if self.handler.state is state:
                return
            self.bus.run(MS)
        raise AssertionError(f"{self.handler.state.value}: {self.handler.fault}")


def parameters(recording: Recording) -> SlaveParams:
    """The configuration of a slave that leads to the recorded Set_Prm and Chk_Cfg."""
    prm = recording.sent_to(PRM)
    return SlaveParams(
        address=recording.slave,
        name="recorded",
        ident=int.from_bytes(prm[4:6], "big"),
        config=recording.sent_to(CFG),
        user_prm=prm[7:],
        watchdog_ms=prm[1] * prm[2] * 10,
        min_tsdr=prm[3],
        groups=tuple(bit + 1 for bit in range(8) if prm[6] >> bit & 1),
        sync=bool(prm[0] & 0x20),
        freeze=bool(prm[0] & 0x10),
    )


def without_factors(set_prm: bytes) -> tuple[bytes, int, bytes]:
    """Set_Prm with its watchdog as a product: there are several ways to say 1950 ms."""
    return set_prm[:1], set_prm[1] * set_prm[2], set_prm[3:]


def data_exchange(recording: Recording, inputs: bytes) -> bytes:
    body = bytes((recording.master, recording.slave, 0x08)) + inputs
    return bytes((0x68, len(body), len(body), 0x68)) + body + bytes((sum(body) & 0xFF, 0x16))


#: the last diagnosis of that recording is cut off after its ident number: as the one before, without Station_Not_Ready
IM151_READY = completed(IM151.pairs[-1][1][:9] + b"\x00" + IM151.pairs[-1][1][10:])


@pytest.mark.parametrize(
    ("recording", "exchange", "ready"),
    [
        (IM151_PLC, data_exchange(IM151_PLC, b"\x81\x42"), b""),
        (IM151, data_exchange(IM151, b"\x81"), IM151_READY),
        (FESTO_CPV, b"\xe5", b""),
    ],
    ids=lambda value: value.name if isinstance(value, Recording) else "",
)
def test_our_master_brings_up_a_recorded_slave(recording: Recording, exchange: bytes, ready: bytes) -> None:
    setup = parameters(recording)
    slave = RecordedSlave(recording, exchange, ready)
    brought = Brought(setup, slave)
    brought.until(SlaveState.DATA_EXCHANGE)
    brought.bus.run(50 * MS)
    assert brought.handler.state is SlaveState.DATA_EXCHANGE
    assert slave.exchanges > 10
    # one Set_Prm and one Chk_Cfg, as the recorded master sent them
    (prm,), (cfg,) = slave.to(PRM), slave.to(CFG)
    assert without_factors(prm) == without_factors(recording.sent_to(PRM))
    assert cfg == recording.sent_to(CFG)
    image = brought.handler.image
    assert image.valid
    assert image.inputs == exchange[7:-2]


def test_stat_diag_of_an_im151_is_waited_for() -> None:
    """Four diagnoses with Stat_Diag: no Data_Exchange before the fifth, which is without."""
    slave = RecordedSlave(IM151_PLC, data_exchange(IM151_PLC, bytes(2)))
    brought = Brought(parameters(IM151_PLC), slave)
    brought.until(SlaveState.DATA_EXCHANGE)
    brought.bus.run(20 * MS)
    order = [octets[7] if octets[0] == 0x68 and octets[4] & 0x80 else 0 for octets in slave.requests]
    after_cfg = order[order.index(CFG) + 1 :]
    assert after_cfg[: after_cfg.index(0)] == [DIAG] * 5
    assert CFG not in after_cfg


def test_a_festo_terminal_whose_watchdog_ran_out_is_brought_up_again() -> None:
    """The terminal refuses Data_Exchange with RS, as recorded; its next diagnosis wants parameters."""
    slave = RecordedSlave(FESTO_CPV, b"\xe5")
    brought = Brought(parameters(FESTO_CPV), slave)
    brought.until(SlaveState.DATA_EXCHANGE)
    brought.bus.run(20 * MS)
    slave.exchange = FESTO_RS
    slave.restart()
    brought.bus.run(5 * MS)
    assert brought.handler.state is not SlaveState.DATA_EXCHANGE
    slave.exchange = b"\xe5"
    brought.until(SlaveState.DATA_EXCHANGE, within_ms=15_000)
    assert slave.count(PRM) == 2


def test_a_diagnosis_that_overflows_with_nothing_is_shown_and_stops_nothing() -> None:
    """A device with Ext_Diag_Overflow in six octets of diagnosis, as recorded."""
    request, answer = TOIT.pairs[0]
    assert is_to(request, DIAG)
    diagnosis = Diagnosis.parse(answer[9:-2])
    assert diagnosis is not None
    assert diagnosis.flags == ("station_not_ready", "prm_req", "ext_diag_overflow")
    assert (diagnosis.ident, diagnosis.blocks, diagnosis.ext_finding) == (0x06D1, (), None)


# --- a recorded master before our slave ---


@pytest.mark.parametrize(
    ("recording", "config"),
    [
        (IM151_PLC, IM151_PLC.sent_to(CFG)),
        (IM151, IM151.sent_to(CFG)),
        (FESTO_CPV, FESTO_CPV.sent_to(CFG)),
        (TI_SITARA, b"\x21"),
    ],
    ids=lambda value: value.name if isinstance(value, Recording) else "",
)
def test_our_slave_answers_a_recorded_master(recording: Recording, config: bytes) -> None:
    """The same answers as the device's: FDL status, SC, Get_Cfg; a diagnosis in its six fixed octets, Stat_Diag and
    Station_Not_Ready left out (our slave is ready at once).
    """
    ident = int.from_bytes(recording.sent_to(PRM)[4:6], "big")
    wire = Wire(make_slave(recording.slave, MirrorDevice(ident, config), PARAMS))
    locked = False
    for request, answer in recording.pairs:
        said = bytes.fromhex(wire.ask(request.hex()))
        if is_to(request, DIAG):
            expected = bytearray(answer[9:15])
            if locked:
                expected[0] &= ~0x02
                expected[1] &= ~0x02
            assert said[9:15] == bytes(expected)
        else:
            assert said == answer, request.hex(" ")
        locked |= is_to(request, PRM)
    assert wire.ask("68 07 07 68 FF 81 46 3A 3E 00 00 3E 16") == ""


def test_our_slave_serves_a_master_that_never_turns_the_fcb() -> None:
    """Its FC is 6D (first request: FCV 0, FCB 1) in each telegram: nothing is taken for a repetition."""
    wire = Wire(make_slave(20, MirrorDevice(0x06D1, bytes.fromhex("9F A0")), PARAMS))
    diag, cfg, prm, exchange = (octets.hex() for is_request, octets in TOIT.lines if is_request)
    assert wire.ask(diag) == "68 0B 0B 68 82 94 08 3E 3C 02 05 00 FF 06 D1 75 16"
    assert wire.ask(prm) == "E5"
    assert wire.ask(cfg) == "E5"
    assert wire.ask(diag)[:38] == "68 0B 0B 68 82 94 08 3E 3C 00 04 00 02"
    answer = "68 13 13 68 02 14 08 01" + " 00" * 15 + " 1F 16"
    assert [wire.ask(exchange) for _ in range(3)] == [answer] * 3


def test_our_slave_serves_class_1_records_to_service_access_point_54_of_a_plc() -> None:
    """An S7 asks from its service access point 54, not 51, and polls there; the answers go back to it."""
    device = MirrorDevice(0x1234, b"\x73")
    device.records = RecordTable({(1, 104): bytes(6)}, writable=[(1, 104)])
    wire = Wire(make_slave(3, device, PARAMS))
    prm = SetPrm(0x1234, user_prm=b"\x80\0\0").build()
    for fc, dsap, data in ((0x6D, PRM, prm), (0x5D, CFG, b"\x73")):
        request = bytes((0x83, 0x82, fc, dsap, 62)) + data
        head = bytes((0x68, len(request), len(request), 0x68))
        assert wire.ask((head + request + bytes((sum(request) & 0xFF, 0x16))).hex()) == "E5"
    fcb = 1
    for request, answer in ASM754.pairs:
        said = wire.ask(completed(request, fcb).hex())
        fcb ^= 1
        if not is_to(request, 51):
            assert len(bytes.fromhex(said)) == len(answer)  # Data_Exchange: our slave is no ASM
        elif answer[9:10] == b"\x5e":
            # a Read gives what was written; of the device it gave its answer to the command
            assert bytes.fromhex(said) == completed(answer[:13] + bytes.fromhex("05 00 00 00 2B 02") + answer[-2:])
        elif answer == b"\xe5":
            assert said == "E5"
        else:
            assert bytes.fromhex(said) == completed(answer)


def test_our_master_counts_a_class_1_slave_like_the_recorded_one_as_dpv1() -> None:
    """Set_Prm of the recorded PLC enables DP-V1 and Fail_Safe in its first user octet; ours does by ``dpv1``."""
    recorded = IM151_PLC.sent_to(PRM)
    assert recorded[7] == 0xC0
    setup = SlaveParams(
        address=8,
        name="recorded",
        ident=0x80E0,
        config=IM151_PLC.sent_to(CFG),
        user_prm=b"\0" + recorded[8:],
        watchdog_ms=1950,
        sync=True,
        freeze=True,
        fail_safe=True,
        fail_safe_told=True,
        dpv1=Dpv1(),
    )
    slave = RecordedSlave(IM151_PLC, data_exchange(IM151_PLC, bytes(2)))
    Brought(setup, slave).until(SlaveState.DATA_EXCHANGE)
    assert without_factors(slave.to(PRM)[0]) == without_factors(recorded)
