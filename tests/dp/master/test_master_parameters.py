"""What a slave's parameters make the master do: lengths, watchdog, SYNC and FREEZE, Min_Slave_Interval."""

from __future__ import annotations

import itertools

import pytest
from scripted_link import MS, RUN, SAFE, data, link, operating, setup, squeezed, wire
from support import present

from dpstack.dp.master.commands import Mode, SetMode
from dpstack.dp.master.events import SlaveState
from dpstack.dp.slave_params import WatchdogTime, watchdog_factors
from dpstack.errors import ConfigError
from dpstack.fdl.interface import Request
from dpstack.fdl.telegram import SHORT_ACK, Telegram

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
    bus.slave.inputs = down
    bus.slave.answers[None] = lambda r: data(r, down) if inputs else SHORT_ACK
    bus.run(20 * MS)
    bus.send(SetMode(Mode.OPERATE), 5 * MS)
    (request,) = [r for r in bus.hold() if r.dsap is None]
    assert (request.data, request.ssap) == (up, None)
    image = bus.image
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

    bus.slave.answers[None] = answer
    bus.run(200 * MS)
    handler = bus.master.handlers[3]
    assert handler.state is SlaveState.FAULT
    assert f"{len(wrong)} octet{'' if len(wrong) == 1 else 's'} instead of 4" in present(handler.fault).message
    assert squeezed(wire(bus)) == [
        (None, "04 7F 40 00"),
        (None, "04 7E 00 00"),
        (61, "40 01 01 0B 06 96 00"),
        (59, ""),  # what it has instead is told
    ]
    safe = [dsap for dsap, octets in wire(bus) if octets == "04 7E 00 00"]
    assert len(safe) * (bus.period + bus.step) >= 45 * MS


# --- watchdog -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("wanted", [1, 10, 11, 95, 200, 2550, 2551, 12_345, 99_999, 650_250])
def test_watchdog_factors_are_never_shorter_and_close(wanted: int) -> None:
    first, second = watchdog_factors(wanted)
    assert 1 <= first <= 255
    assert 1 <= second <= 255
    effective = first * second * 10
    assert wanted <= effective
    assert effective <= max(wanted * 1.02 + 10, 10)


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
    watchdog = present(slave.watchdog(0))
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
    bus.run_anew(10 * MS)
    assert sum(r.da == 4 for r in bus.requests) > 10  # one that is away holds nobody up
