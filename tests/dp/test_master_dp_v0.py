"""DP-V0 at the master's end, service by service, with literal octets: docs/dp-v0.md names these tests."""

from __future__ import annotations

import itertools
from typing import Any

import pytest
from scripted_link import DIAG_READY, MS, ScriptedLink, ScriptedSlave, data

from dpstack.dp.commands import (
    ActivateSlave,
    DeactivateSlave,
    Mode,
    ReparameteriseSlave,
    SetMode,
)
from dpstack.dp.diag_bits import FLAGS, Does, SetBy
from dpstack.dp.events import (
    AutoCleared,
    OperateWaits,
    SlaveDiagnosis,
    SlaveState,
)
from dpstack.dp.master import Master
from dpstack.dp.setup import SlaveSetup, WatchdogTime
from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.telegram import SHORT_ACK, Telegram
from dpstack.fdl.user import Request
from dpstack.params import BusParams

SAFE = b"\x04\x7e\x00\x00"
RUN = b"\x04\x7f\x40\x00"


def setup(address: int = 3, **changes: Any) -> SlaveSetup:
    values: dict[str, Any] = {"address": address, "name": f"s{address}", "ident": 0x0696, "config": b"\x71"}
    return SlaveSetup(**(values | changes))


def link(*setups: SlaveSetup, **options: Any) -> ScriptedLink:
    master = Master(BusParams.preset(500_000, address=2), setups, **options)
    return ScriptedLink(master, {s.address: ScriptedSlave() for s in setups})


def operating(*setups: SlaveSetup, **options: Any) -> ScriptedLink:
    bus = link(*setups, **options)
    bus.run(20 * MS)
    bus.master.command(SetMode(Mode.OPERATE), bus.now)
    bus.run(5 * MS)
    assert mode_of(bus) is Mode.OPERATE
    bus.requests.clear()
    bus.events.clear()
    return bus


def inputs_valid(bus: ScriptedLink) -> bool:
    return bus.master.images[3].valid


def mode_of(bus: ScriptedLink) -> Mode:
    return bus.master.mode


def wire(bus: ScriptedLink, address: int = 3) -> list[Entry]:
    """What was sent to one slave: DSAP and octets."""
    return [(r.dsap, r.data.hex(" ").upper()) for r in bus.requests if r.da == address]


def squeezed(entries: list[Entry]) -> list[Entry]:
    """Without repetitions."""
    return [entry for at, entry in enumerate(entries) if not at or entry != entries[at - 1]]


# --- the whole bring-up for each fault of the diagnosis bits --------------------------------------------------------

Entry = tuple[int | None, str]
_DIAG: Entry = (60, "")
_PRM: Entry = (61, "88 01 14 0B 06 96 00")
_CFG: Entry = (62, "71")
_GET: Entry = (59, "")
_UP = [_DIAG, _PRM, _CFG, _DIAG]
_DX: Entry = (None, "00 00 00 00")
#: bit -> the diagnosis after Chk_Cfg, what the master sends in the first second, where it ends, the fault's kind
TRANSCRIPTS: dict[str, tuple[str, list[Entry], str, str]] = {
    "station_not_ready": ("02 0C 00 02 06 96", _UP, "wait_ready", ""),
    "cfg_fault": ("06 0D 00 FF 06 96", [*_UP, _GET], "fault", "cfg_fault"),
    "ext_diag": ("08 0C 00 02 06 96 03 11 22", [*_UP, _DX], "data_exchange", ""),
    "not_supported": ("12 05 00 FF 06 96", _UP, "fault", "not_supported"),
    "prm_fault": ("42 05 00 FF 06 96", _UP, "fault", "prm_fault"),
    "prm_req": ("02 05 00 FF 06 96", [*_UP, *(_UP[1:] * 3)], "fault", "not_ready"),
    "stat_diag": ("00 0E 00 02 06 96", _UP, "wait_ready", ""),
    "wd_on": ("00 0C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "freeze_mode": ("00 1C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "sync_mode": ("00 2C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "ext_diag_overflow": ("00 0C 80 02 06 96", [*_UP, _DX], "data_exchange", ""),
    # the master's own bits: from a slave they mean nothing, and are told once
    "station_non_existent": ("01 0C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "invalid_slave_response": ("20 0C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "master_lock": ("80 0C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "not_present": ("00 4C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
    "deactivated": ("00 8C 00 02 06 96", [*_UP, _DX], "data_exchange", ""),
}


@pytest.mark.parametrize("name", list(TRANSCRIPTS))
def test_transcript_of_the_bring_up_for_each_bit(name: str) -> None:
    octets, expected, state, kind = TRANSCRIPTS[name]
    bus = link(setup())
    slave = bus.slaves[3]
    slave.ready = bytes.fromhex(octets)
    slave.answers[59] = lambda r: data(r, b"\xf1")
    bus.run(900 * MS)
    made = wire(bus)
    if state == "wait_ready":  # asked again and again
        assert made[: len(expected)] == expected
        assert set(made[len(expected) :]) == {_DIAG}
    else:
        assert squeezed(made)[: len(expected)] == squeezed(expected)
        assert set(made[len(expected) :]) <= {_DX}
    handler = bus.master.handlers[3]
    assert handler.state.value == state
    assert (handler.fault.kind.value if handler.fault else "") == kind
    ours = next(flag for flag in FLAGS if flag.name == name).set_by is SetBy.MASTER
    assert any("which only a master may" in text for text in bus.remarks(3)) == ours


def test_the_transcripts_are_of_every_bit() -> None:
    assert set(TRANSCRIPTS) == {flag.name for flag in FLAGS}


@pytest.mark.parametrize("flag", [f for f in FLAGS if f.set_by is SetBy.SLAVE], ids=lambda f: f.name)
def test_each_bit_in_data_exchange(flag: Any) -> None:
    """By a diagnosis after a high-priority answer; the table says what follows."""
    bus = operating(setup())
    octets = bytearray.fromhex("00 0C 00 02 06 96")
    octets[flag.octet - 1] |= flag.mask
    bus.slaves[3].ready = bytes(octets)
    bus.slaves[3].answers[None] = lambda r: data(r, bytes(4), fc=0x0A)
    bus.hold()
    bus.slaves[3].answers.clear()
    made = bus.hold()
    assert [r.dsap for r in made if r.da == 3] == [None, 60]  # at once
    state, valid = bus.master.handlers[3].state, bus.master.images[3].valid
    wanted: tuple[SlaveState, bool] = {
        Does.TELLS: (SlaveState.DATA_EXCHANGE, True),
        Does.WAITS: (SlaveState.DATA_EXCHANGE, False),
        Does.PARAMETERISES: (SlaveState.DIAGNOSIS, False),
        Does.REFUSES: (SlaveState.FAULT, False),
    }[flag.exchange]
    assert (state, valid) == wanted
    diagnosis = bus.master.handlers[3].diagnosis
    assert diagnosis is not None
    assert flag.name in diagnosis.flags


def test_stat_diag_is_polled_until_it_is_gone_and_outputs_go_on() -> None:
    bus = operating(setup(initial=RUN))
    bus.slaves[3].ready = bytes.fromhex("00 0E 00 02 06 96")
    bus.slaves[3].answers[None] = lambda r: data(r, bytes(4), fc=0x0A)
    bus.hold()
    bus.slaves[3].answers.clear()
    bus.requests.clear()
    bus.run(1_000 * MS)
    assert 9 <= sum(dsap == 60 for dsap, _ in wire(bus)) <= 12
    assert not inputs_valid(bus)
    assert {octets for dsap, octets in wire(bus) if dsap is None} == {RUN.hex(" ").upper()}
    bus.slaves[3].ready = DIAG_READY
    bus.run(200 * MS)
    bus.requests.clear()
    bus.run(500 * MS)
    assert inputs_valid(bus)
    assert not any(dsap == 60 for dsap, _ in wire(bus))


def test_a_slave_that_always_has_a_diagnosis_takes_every_other_turn_at_most() -> None:
    bus = operating(setup(3), setup(4))
    bus.slaves[3].answers[None] = lambda r: data(r, bytes(4), fc=0x0A)
    bus.slaves[4].configured = False
    bus.run(1_500 * MS)
    assert bus.master.handlers[4].state is SlaveState.DATA_EXCHANGE


def test_a_slave_that_does_not_watch_its_master_is_told() -> None:
    bus = link(setup(), setup(4, watchdog_ms=0))
    for slave in bus.slaves.values():
        slave.ready = bytes.fromhex("00 04 00 02 06 96")
    bus.run(50 * MS)
    assert any("WD_On is 0" in text for text in bus.remarks(3))
    assert bus.remarks(4) == []


# --- extended diagnosis ---------------------------------------------------------------------------------------------


class Texts:
    """As a GSD file gives them."""

    def unit_diag_texts(self, octets: bytes) -> tuple[str, ...]:
        return ("24 V is missing",) if octets[:1] == b"\x01" else ()

    def unit_diag_helps(self, octets: bytes) -> tuple[str, ...]:
        return ("",) * len(self.unit_diag_texts(octets))

    def channel_text(self, error_type: int, module: int | None = None) -> str | None:
        return {16: "sensor dirty"}.get(error_type)

    def channel_help(self, error_type: int, module: int | None = None) -> str | None:
        return None

    def module_name(self, module: int) -> str:
        return ""


def test_extended_diagnosis_is_told_in_words() -> None:
    bus = link(setup(3, texts=Texts()), setup(4))
    for slave in bus.slaves.values():
        slave.ready = bytes.fromhex("08 0C 00 02 06 96 03 01 00 42 05 82 43 B0 C7")
    bus.run(20 * MS)
    told = {e.address: e.texts for e in bus.events if isinstance(e, SlaveDiagnosis)}
    channel = "module 2, input channel 3 (word)"
    assert told[3] == ("24 V is missing", "modules with a diagnosis: 0, 2", f"{channel}: sensor dirty")
    assert told[4] == ("device: 01 00", "modules with a diagnosis: 0, 2", f"{channel}: error 16")


def test_lengths_that_lie_are_a_finding_and_nothing_more() -> None:
    bus = link(setup())
    bus.slaves[3].ready = bytes.fromhex("08 0C 00 02 06 96 C7 48 05")
    bus.run(20 * MS)
    handler = bus.master.handlers[3]
    assert handler.state is SlaveState.DATA_EXCHANGE
    assert any("octet 8 announces a block of 8 octets, 2 are left" in text for text in bus.remarks(3))
    bus.slaves[3].ready = bytes.fromhex("08 0C 00 02 06 96 C7 40 05")
    assert handler.diagnosis is not None
    assert handler.diagnosis.ext == b"\xc7\x48\x05"


# --- the master's own bits ------------------------------------------------------------------------------------------


def test_the_bits_a_master_sets() -> None:
    bus = link(setup(3), setup(4), setup(5), setup(6))
    del bus.slaves[3]
    bus.slaves[4].free = bytes.fromhex("00 0C 00 07 06 96")
    bus.slaves[5].inputs = b"\x01"
    bus.run(1_000 * MS)
    bus.master.command(DeactivateSlave(6), bus.now)
    seen = {a: h.diagnosis for a, h in bus.master.handlers.items()}
    assert {a: d.flags for a, d in seen.items() if d is not None} == {
        3: ("station_non_existent",),
        4: ("master_lock", "wd_on"),
        5: ("invalid_slave_response", "wd_on"),
        6: ("wd_on", "deactivated"),
    }


# --- lengths --------------------------------------------------------------------------------------------------------

_LENGTHS = [
    ("00", 0, 0),  # an empty slot: neither
    ("10", 1, 0),
    ("20", 0, 1),
    ("71", 4, 4),
    ("C0 BF BF", 64, 64),  # special format: 64 octets, consistent over the whole
    ("C0 FF FF", 128, 128),
    ("C0 FF FF C0 F9 F9", 244, 244),
]


@pytest.mark.parametrize(("config", "inputs", "outputs"), _LENGTHS)
def test_data_of_every_length_each_way(config: str, inputs: int, outputs: int) -> None:
    """All octets of one Data_Exchange are one telegram and one assignment: consistent over the whole slave."""
    up = bytes(range(1, 245))[:outputs]
    slave = setup(config=bytes.fromhex(config), initial=up)
    assert (slave.input_len, slave.output_len) == (inputs, outputs)
    bus = link(slave)
    down = bytes(range(244, 0, -1))[:inputs]
    bus.slaves[3].inputs = down
    bus.slaves[3].answers[None] = lambda r: data(r, down) if inputs else SHORT_ACK
    bus.run(20 * MS)
    bus.master.command(SetMode(Mode.OPERATE), bus.now)
    bus.run(5 * MS)
    (request,) = [r for r in bus.hold() if r.dsap is None]
    assert (request.data, request.ssap) == (up, None)
    image = bus.master.images[3]
    assert (image.inputs, image.valid) == (down, True)
    assert bus.master.handlers[3].exchanges > 10


def test_one_octet_more_than_fits_is_refused() -> None:
    with pytest.raises(ConfigError, match="246 input and 0 output octets; 244 each are possible"):
        setup(config=bytes.fromhex("40 FF 40 FA"))


@pytest.mark.parametrize("wrong", [b"", b"\x01", bytes(3), bytes(5), bytes(244)])
def test_a_wrong_length_is_given_up_with_safe_values_at_once(wrong: bytes) -> None:
    """Its outputs must not stand until its watchdog, which may be off."""
    bus = operating(setup(safe=SAFE, initial=RUN, watchdog_ms=0))

    def answer(request: Request) -> Telegram:
        return data(request, wrong)

    bus.slaves[3].answers[None] = answer
    bus.run(200 * MS)
    handler = bus.master.handlers[3]
    assert handler.state is SlaveState.FAULT
    assert handler.fault is not None
    assert f"{len(wrong)} octets instead of 4" in handler.fault.message
    assert squeezed(wire(bus)) == [
        (None, "04 7F 40 00"),
        (None, "04 7E 00 00"),
        (61, "40 01 01 0B 06 96 00"),
    ]
    safe = [dsap for dsap, octets in wire(bus) if octets == "04 7E 00 00"]
    assert len(safe) * (bus.period + bus.step) >= 45 * MS


# --- watchdog -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ms", "fine", "factors", "base", "effective"),
    [
        (200, False, (1, 20), 10, 200),
        (95, False, (1, 10), 10, 100),
        (95, True, (1, 95), 1, 95),
        (200, True, (1, 20), 10, 200),  # no gain: the base that every slave knows
        (7, True, (1, 7), 1, 7),
        (65_026, True, (29, 225), 10, 65_250),
    ],
)
def test_the_watchdog_is_rounded_up_and_takes_the_1_ms_base_where_it_helps(
    ms: int, fine: bool, factors: tuple[int, int], base: int, effective: int
) -> None:
    slave = setup(watchdog_ms=ms, wd_base_1ms=fine, user_prm=b"\x80\x00\x00")
    watchdog = slave.watchdog(0)
    assert watchdog is not None
    assert watchdog.base_ms == base
    assert ms <= watchdog.ms <= max(effective, ms + 10)
    if ms < 1000:
        assert watchdog == WatchdogTime(factors, base)


def test_wd_base_1ms_on_the_wire() -> None:
    bus = link(setup(watchdog_ms=95, wd_base_1ms=True, user_prm=b"\x80\x00\x00"))
    bus.run(20 * MS)
    assert wire(bus)[1] == (61, "88 01 5F 0B 06 96 00 84 00 00")  # 5F = 95, WD_Base_1ms = bit 2 of the first octet
    assert bus.master.handlers[3].watchdog_effective_ns == 95 * MS
    with pytest.raises(ConfigError, match="three DPV1_Status octets"):
        setup(wd_base_1ms=True)


def test_sync_and_freeze_are_asked_for_in_set_prm() -> None:
    bus = link(setup(sync=True, freeze=True, groups=(1, 8)))
    bus.run(20 * MS)
    assert wire(bus)[1] == (61, "B8 01 14 0B 06 96 81")


# --- Min_Slave_Interval ---------------------------------------------------------------------------------------------


def test_min_slave_interval_is_kept_free_running() -> None:
    bus = operating(setup(3, min_slave_interval_ns=3 * MS), setup(4))
    starts: list[int] = []
    for _ in range(600):
        before = bus.now + bus.period
        if any(r.da == 3 and r.dsap is None for r in bus.hold()):
            starts.append(before)
    gaps = [b - a for a, b in itertools.pairwise(starts)]
    assert len(gaps) > 10
    assert min(gaps) >= 3 * MS
    bus.slaves.pop(3)
    bus.run(50 * MS)
    bus.requests.clear()
    bus.run(10 * MS)
    assert sum(r.da == 4 for r in bus.requests) > 10  # one that is away holds nobody up


# --- auto-clear -----------------------------------------------------------------------------------------------------


def test_operate_with_auto_clear_waits_for_all_slaves() -> None:
    bus = link(setup(3), setup(4), auto_clear=True)
    gone = bus.slaves.pop(4)
    bus.master.command(SetMode(Mode.OPERATE), bus.now)
    bus.run(500 * MS)
    assert mode_of(bus) is Mode.CLEAR
    (waits,) = [e for e in bus.events if isinstance(e, OperateWaits)]
    assert waits.slaves == (3, 4)
    bus.slaves[4] = gone
    bus.run(1_500 * MS)
    assert mode_of(bus) is Mode.OPERATE


def test_auto_clear_after_the_data_control_time_and_back_by_order_only() -> None:
    bus = operating(setup(3), setup(4, safe=SAFE, initial=RUN), auto_clear=True, data_control_ns=300 * MS)
    lost = bus.slaves.pop(3)
    began = bus.now
    while bus.master.mode is Mode.OPERATE:
        bus.hold()
    (cleared,) = [e for e in bus.events if isinstance(e, AutoCleared)]
    assert 299 * MS <= cleared.t_ns - began <= 310 * MS
    assert cleared.slaves == (3,)
    assert "slave 3 (s3) had no data exchange for 300 ms (stopped answering during Data_Exchange)" in cleared.text
    assert squeezed([e for e in wire(bus, 4) if e[0] is None])[1] == (None, "04 7E 00 00")  # safe values first
    lost.configured = False
    bus.slaves[3] = lost
    bus.run(2_000 * MS)
    assert bus.master.handlers[3].state is SlaveState.DATA_EXCHANGE
    assert mode_of(bus) is Mode.CLEAR
    bus.master.command(SetMode(Mode.OPERATE), bus.now)
    bus.run(5 * MS)
    assert mode_of(bus) is Mode.OPERATE


@pytest.mark.parametrize("how", ["off", "ignored", "deactivated"])
def test_no_auto_clear_for_a_slave_that_does_not_count(how: str) -> None:
    bus = operating(setup(3), setup(4, ignore_auto_clear=how == "ignored"), auto_clear=how != "off")
    if how == "deactivated":
        bus.master.command(DeactivateSlave(4), bus.now)
        bus.run(100 * MS)
    del bus.slaves[4]
    bus.run(3_000 * MS)
    assert mode_of(bus) is Mode.OPERATE


# --- out of service, parameterised anew -----------------------------------------------------------------------------


def test_deactivate_and_activate() -> None:
    bus = operating(setup(3, safe=SAFE, initial=RUN), setup(4))
    bus.master.command(DeactivateSlave(3), bus.now)
    assert bus.master.handlers[3].state is SlaveState.DEACTIVATED
    bus.run(2_000 * MS)
    assert squeezed(wire(bus)) == [(None, "04 7E 00 00"), (61, "40 01 01 0B 06 96 00")]
    assert not bus.master.images[3].valid
    bus.slaves[3].configured = False
    bus.requests.clear()
    bus.master.command(ActivateSlave(3), bus.now)
    bus.run(20 * MS)
    assert squeezed(wire(bus))[:5] == [_DIAG, _PRM, _CFG, _DIAG, (None, "04 7F 40 00")]
    assert bus.states(3)[0] == "deactivated"


def test_parameterised_anew_while_the_bus_runs() -> None:
    bus = operating(setup(3, safe=SAFE, initial=RUN), setup(4))
    image = bus.master.images[3]
    slave = bus.slaves[3]

    def unlocked(request: Request) -> Telegram:
        slave.configured = False
        return SHORT_ACK

    slave.answers[61] = unlocked
    others = bus.master.handlers[4].exchanges
    order = ReparameteriseSlave(setup(3, user_prm=b"\xaa", groups=(2,), watchdog_ms=500, safe=SAFE))
    bus.master.command(order, bus.now)
    bus.run(100 * MS)
    assert squeezed(wire(bus))[:7] == [
        (None, "04 7E 00 00"),
        (61, "40 01 01 0B 06 96 00"),
        _DIAG,
        (61, "88 01 32 0B 06 96 02 AA"),
        _CFG,
        _DIAG,
        (None, "04 7F 40 00"),
    ]
    assert bus.master.images[3] is image
    assert bus.master.handlers[4].exchanges - others > 100  # nobody else noticed


class Unit:
    """A cyclic unit that counts its losses."""

    losses = 0

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        return bytes(4)

    def lost(self, now: int) -> None:
        self.losses += 1

    def safe(self, configured: bytes) -> bytes:
        return configured

    def command(self, op: str, args: object, token: int, now: int) -> None: ...

    def take_events(self) -> list[dict[str, object]]:
        return []


def test_a_plugin_is_told_and_nothing_is_half_applied() -> None:
    bus = operating(setup(3))
    unit = bus.master.images[3].unit = Unit()
    before = bus.master.handlers[3]
    with pytest.raises(UsageError, match="its drive plugin is made for 4 octets of inputs"):
        bus.master.command(ReparameteriseSlave(setup(3, config=b"\x10")), bus.now)
    with pytest.raises(UsageError, match="no slave with address 9"):
        bus.master.command(ReparameteriseSlave(setup(9)), bus.now)
    bus.run(10 * MS)
    assert bus.master.handlers[3] is before
    assert before.state is SlaveState.DATA_EXCHANGE
    assert unit.losses == 0
    bus.master.command(ReparameteriseSlave(setup(3, groups=(1,))), bus.now)
    assert unit.losses == 1
    assert bus.master.images[3].unit is unit


def test_other_lengths_make_a_new_image() -> None:
    bus = operating(setup(3))
    bus.master.command(ReparameteriseSlave(setup(3, config=b"\x20\x10")), bus.now)
    image = bus.master.images[3]
    assert (image.inputs, image.outputs) == (b"\x00", b"\x00")


def test_an_answer_to_the_old_parameters_is_nobodys() -> None:
    bus = operating(setup(3))
    bus.now += bus.period
    bus.master.token_received(bus.now)
    request = bus.master.next_request(bus.now, False)
    assert request is not None
    bus.master.command(DeactivateSlave(3), bus.now)
    bus.master.result(request, data(request, b"\xff" * 4), bus.now)
    assert not bus.master.images[3].valid
    assert bus.master.images[3].inputs == bytes(4)
