"""KEB's simulated drive against literal octets: services, control and status word, timing, watchdog
(docs/reference/drives/keb-f5.md)."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

import pytest
from drive_bench import MS, START, DeviceBench, S
from slave_kit import Bench

from dpstack.dp.slave.application import SlaveApp, SlaveAppState
from dpstack.fdl.interface import Reply
from dpstack.fdl.telegram import Resp
from dpstack_drives.keb import DRIVE
from dpstack_drives.keb.watchdog import Life, Watchdog
from tests.drives.keb_kit import IDLE, NONE, KebBench, again, device, sim

#: enable and run of the simulated drive's own bits; 1500 rpm are 05DC
RUN = "00 05 05 DC"


# -- docs/reference/drives/keb-f5.md#services --------------------------------------------------------------------------


def test_k1_every_service() -> None:
    """Set_Prm without user parameters, ident 05EB; Chk_Cfg A3 93; Get_Cfg, RD_Inp, RD_Outp, Slave_Diag, controls."""
    app = SlaveApp(DRIVE.simulated("4/4", {}, {}), address=8)
    bench = Bench(app.device, app)
    assert bench.diag() == bytes.fromhex("02 05 00 FF 05 EB")
    assert bench.ask(59) == Reply(Resp.DL, bytes.fromhex("A3 93"))  # Get_Cfg
    bench.prm_and_cfg(bytes.fromhex("B8 01 0A 0B 05 EB 02"), bytes.fromhex("A3 93"))  # lock, sync, freeze, watchdog
    assert app.state is SlaveAppState.DATA_EXCH
    assert len(bench.diag()) == 6
    assert bench.dx(bytes.fromhex("00 05 05 DC")).data == bytes.fromhex("00 01 00 00")
    bench.now += 60 * MS
    data = bench.dx(bytes.fromhex("00 05 05 DC")).data
    assert data[:2] == bytes.fromhex("00 05")
    assert bench.ask(56) == Reply(Resp.DL, data)  # RD_Inp
    assert bench.ask(57) == Reply(Resp.DL, bytes.fromhex("00 05 05 DC"))  # RD_Outp
    bench.control(bytes.fromhex("08 00"))  # FREEZE
    bench.now += 60 * MS
    assert bench.dx(bytes.fromhex("00 05 05 DC")).data == data
    bench.control(bytes.fromhex("04 00"))  # UNFREEZE
    assert bench.dx(bytes.fromhex("00 05 05 DC")).data != data
    bench.control(bytes.fromhex("20 00"))  # SYNC: outputs wait
    bench.now += 60 * MS
    bench.dx(bytes.fromhex("00 00 00 00"))
    bench.now += 60 * MS
    assert bench.dx(bytes.fromhex("00 00 00 00")).data[1] & 0x04  # still running
    bench.control(bytes.fromhex("10 00"))  # UNSYNC
    bench.now += 60 * MS
    assert not bench.dx(bytes.fromhex("00 00 00 00")).data[1] & 0x04


def test_k1_user_parameters_are_refused() -> None:
    assert "user parameters" in str(DRIVE.device().check_prm(b"\x01"))
    assert DRIVE.device().check_prm(b"") is None


# -- words (the bits are made up) --------------------------------------------------------------------------------------


def test_k8_run_stop_reverse_and_a_fault() -> None:
    bench = sim()
    assert bench.send("00 00 00 00") == "00 01 00 00"
    assert bench.send("00 01 05 DC") == "00 01 00 00"  # no run
    assert bench.send(RUN, 1200) == "00 15 05 DC"  # running, reached: 1500 rpm
    assert bench.send("00 05 02 EE", 700) == "00 15 02 EE"
    assert bench.send("00 0D 02 EE", 1300) == "00 1D FD 12"  # reverse bit with an absolute set speed
    assert bench.send("00 0D FD 12", 100) == "00 1D FD 12"  # oP.01 = 9: absolute
    stopping = bench.send("00 09 02 EE", 100)
    assert stopping[:5] == "00 0D"  # still driven, on its ramp
    assert bench.send("00 09 02 EE", 700) == "00 01 00 00"
    bench.send(RUN, 1200)
    bench.device.trip("E.OL")
    assert bench.send(RUN, 60) == "00 02 00 00"
    assert bench.send("00 07 05 DC", 60)[:5] == "00 05"  # the edge of reset, and it runs again
    assert bench.send("00 04 05 DC", 60) == "00 01 00 00"  # enable gone: coasts
    bench.send(RUN, 1200)
    quick = bench.send("01 05 05 DC", 250)
    assert quick == "00 01 00 00"  # quick stop in 0.2 s


def test_k8_the_recipe_makes_it_obey() -> None:
    """oP.01 = 9: sy.50 commands; oP.00 = 5: sy.52 is the set speed."""
    assert sim({"oP.01": 2}).send(RUN, 500) == "00 01 00 00"
    assert sim({"oP.00": 0}).send(RUN, 500) == "00 15 00 00"


def test_k8_the_control_word_as_a_long_and_over_the_channel() -> None:
    """sy.43's low half is sy.50; a parameter written over the channel counts like process data."""
    bench = sim(telegram="PCH+0/4")
    assert bench.send("72 01 20 34 00 00 05 DC")[:23] == "42 01 20 34 00 00 05 DC"
    assert bench.send("32 01 20 2B 00 00 00 05", 1200) == "02 01 20 2B 00 00 00 05 00 15 05 DC"
    assert bench.send("71 01 20 2C 00 00 00 00")[:23] == "41 01 20 2C 00 00 00 15"
    assert bench.device.store.eeprom_writes == 0


def test_limits_and_ramps() -> None:
    bench = sim({"oP.10": 25, "oP.28": 2})
    assert bench.send(RUN, 600)[:5] == "00 05"  # 0.3 of 0.5 after 0.6 s of a 2 s ramp
    assert bench.send(RUN, 600) == "00 15 02 EE"


# -- docs/reference/drives/keb-f5.md#when-data-move --------------------------------------------------------------------


@pytest.mark.parametrize(("cycle", "presets"), [(25, NONE), (7, {"Fb.09": 7}), (1, {"Fb.09": 0})])
def test_k9_inputs_are_read_every_pd_in_cycle(cycle: int, presets: Mapping[str, object]) -> None:
    bench = sim(presets)
    bench.rotation = MS
    changes: list[int] = []
    last = ""
    for _ in range(400):
        now = bench.send(RUN, 1)
        if now != last:
            changes.append((bench.now - START) // MS)
            last = now
    assert {b - a for a, b in pairwise(changes[3:])} == {cycle}


def test_k9_outputs_reach_the_inverter_only_when_they_change() -> None:
    bench = sim()
    bench.send(RUN, 500)
    assert bench.device.operator.output_telegrams == 1
    bench.send("00 05 05 DD", 500)
    bench.send(RUN, 500)
    assert bench.device.operator.output_telegrams == 3
    # what was written behind its back stays until the outputs change
    bench.device.store.write(next(p for p in bench.device.store.table if p.name == "sy.50"), 0, ram_only=True)
    assert bench.send(RUN, 1500) == "00 01 00 00"
    assert bench.send("00 05 05 DD", 60)[:5] == "00 05"


def _two_blocks(com_cycle: float = 0.0) -> KebBench:
    """The test map of docs/reference/drives/keb-f5.md#second-block, active."""
    telegram = "8+2/8+4 own-gsd"
    options: Mapping[str, object] = {"Fb.09": 0, "com_cycle_us": com_cycle}
    first = device(telegram, options)
    requests = [
        (0x6000, [12, 0x202C, 1, 0, 0, 0, 0, 0, 0, 0x2033, 1, 0, 0, 0x2035, 1, 0, 0]),
        (0x6001, [10, 0x2F13, 1, 0, 0, 0, 0, 0, 0, 0x2032, 1, 0, 0, 0x2034, 1, 0, 0]),
    ]
    for index, values in requests:
        for subindex, value in enumerate(values, 1):
            first.operator.access(index, subindex, value)
    for index, values in ((0x5FE0, [0x2200, 1, 0, 0, 0x2227, 1]), (0x5FE2, [0x230A, 1])):
        for subindex, value in enumerate(values, 2):
            first.operator.access(index, subindex, value)
    for enable in (0x5FF8, 0x6002, 0x5FE1, 0x5FE3):
        with pytest.raises(Exception, match="8/0/0034"):
            first.operator.access(enable, 0, 0xFF)
    return DeviceBench(again(first, telegram, options), "A7 A1 97 93", MS)


OUTPUTS = "00 00 00 00 00 05 05 DC "  # cS.19, sy.50, sy.52; oP.10 is the last word


def test_k9_k12_two_blocks_take_two_telegrams_and_half_the_rate() -> None:
    """Block 2 right after block 1; block 1 again after both: 2 ms where one block takes 1 ms."""
    bench = _two_blocks()
    inputs = bench.send(OUTPUTS + "15 E0", 1500)
    assert inputs == "00 00 00 15 00 15 05 DC 00 42 00 00"  # sy.44, sy.51, sy.53, ru.00, ru.39
    assert bench.device.operator.output_telegrams == 2
    bench.device.trip("E.OL")
    seen = [bench.send(OUTPUTS + "15 E0", 1) for _ in range(6)]
    first = next(n for n, text in enumerate(seen) if text[12:17] == "00 02")
    second = next(n for n, text in enumerate(seen) if text[24:29] == "00 10")
    assert abs(first - second) == 1
    bench.send(OUTPUTS + "15 E0", 1)
    bench.send("00 00 00 00 00 06 05 DC 15 E0", 5)  # reset
    speeds = [bench.send(OUTPUTS + "15 E0", 1)[18:23] for _ in range(300)][10:]  # on the ramp: new in every ms
    changes = [n for n, (old, new) in enumerate(pairwise(speeds)) if old != new]
    assert {b - a for a, b in pairwise(changes)} == {2}
    before = bench.device.operator.output_telegrams
    bench.send(OUTPUTS + "15 E1", 10)
    assert bench.device.operator.output_telegrams == before + 1  # only the block that changed


@pytest.mark.parametrize(("com_cycle", "cycle"), [(1000, 2), (2000, 2), (5000, 5)])
def test_k9_the_cyclic_mode_has_a_grid(com_cycle: float, cycle: int) -> None:
    """At best 2 ms, with SelComCycle 1000 or 2000; both blocks go with every grid."""
    bench = _two_blocks(com_cycle)
    bench.send(OUTPUTS + "15 E0", 20)
    before = bench.device.operator.output_telegrams
    changes: list[int] = []
    last = ""
    for _ in range(100):
        now = bench.send(OUTPUTS + "15 E0", 1)
        if now != last:
            changes.append(bench.now // MS)
            last = now
    assert {b - a for a, b in pairwise(changes[1:])} == {cycle}
    assert bench.device.operator.output_telegrams - before == pytest.approx(2 * 100 / cycle, abs=2)


# -- docs/reference/drives/keb-f5.md#watchdog-of-the-operator ----------------------------------------------------------

#: trips at once after 0.1 s
TRIPS: Mapping[str, object] = {"Pn.05": 0, "Pn.06": 0.1}


def tripped(bench: KebBench) -> int:
    return bench.device.fault


def test_k10_as_delivered_it_goes_on_for_ever() -> None:
    bench = sim()
    bench.send(RUN, 1200)
    bench.lose(20_000)
    assert bench.device.motor.on
    assert bench.device.motor.frequency == 1.0
    assert not tripped(bench)


def test_k10_pn06_is_the_time_to_the_trip() -> None:
    bench = sim(TRIPS)
    bench.send(RUN, 1200)
    bench.lose(99)
    assert bench.device.motor.on
    bench.pass_time(3)
    assert (tripped(bench), bench.device.motor.on) == (18, False)
    bench.device.enter(bench.config, bench.now)
    assert bench.send(RUN, 60)[:5] == "00 02"  # the trip stays when the bus is back


@pytest.mark.parametrize(("after_s", "inputs"), [(4, "00 15 05 DC"), (2, "00 02 00 00")])
def test_k10_a_master_that_is_away_for_3_s_is_seen_without_the_watchdog_of_set_prm(after_s: float, inputs: str) -> None:
    """The slave stays in data exchange, but nothing arrives: only the watchdog of the operator stops the drive."""
    bench = sim({"Pn.05": 0, "Pn.06": after_s})
    bench.send(RUN, 1200)
    bench.now += 3000 * MS
    assert bench.send(RUN, 60) == inputs


@pytest.mark.parametrize(("how", "fault", "output"), [(0, 18, False), (1, 18, False), (6, 0, True)])
def test_k10_pn05_is_what_happens(how: int, fault: int, output: bool) -> None:
    """6 is the manual's: a digital output; 0 and 1 (after a quick stop) are readings."""
    bench = sim({"Pn.05": how, "Pn.06": 0.1})
    bench.send(RUN, 1200)
    bench.lose(150)
    assert bench.device.motor.on == (how != 0)
    bench.pass_time(500)
    assert (tripped(bench), bench.device.digital_output) == (fault, output)
    assert bench.device.motor.on == (how == 6)


def test_k10_outputs_alone_starve_it_when_they_do_not_change() -> None:
    """Fb40 = 1: only the beginning of an output telegram keeps it alive."""
    bench = sim({**TRIPS, "Fb.40": 1})
    for turn in range(10):
        bench.send(f"00 05 05 D{turn % 2}", 90)
    assert not tripped(bench)
    bench.send("00 05 05 D1", 110)
    assert tripped(bench) == 18


def test_k10_requests_keep_it_alive() -> None:
    """Fb40 = 2."""
    bench = sim({**TRIPS, "Fb.40": 2}, "PCH+4/4")
    for turn in range(10):
        bench.send(("71" if turn % 2 else "31") + " 01 20 33 00 00 00 00 " + RUN, 90)
    assert not tripped(bench)
    bench.send("71 01 20 33 00 00 00 00 " + RUN, 110)
    assert tripped(bench) == 18


@pytest.mark.parametrize(
    ("activation", "life", "begun"),
    [
        (0, Life(0), True),
        (1, Life(0), False),
        (1, Life.REQUEST, False),
        (1, Life.OUTPUTS, True),
        (2, Life.OUTPUTS, False),
        (2, Life.REQUEST, True),
        (3, Life(0), False),
        (3, Life.REQUEST, True),
    ],
)
def test_k10_fb39_is_when_it_begins(activation: int, life: Life, begun: bool) -> None:
    watchdog = Watchdog()

    def step(signs: Life, now: int) -> bool:
        return watchdog.step(signs, now, activation=activation, inhibit=0, time_ns=S)

    assert not step(life, 0)
    assert not step(Life.EXCHANGE, S - 1)
    assert step(Life(0), S) == begun
    assert not step(Life(0), 2 * S)  # once


def test_k10_sy09_supervises_the_inner_link() -> None:
    bench = sim({"sy.09": 0.2, "Pn.05": 0})
    bench.send(RUN, 1200)
    bench.device.link(False)
    frozen = bench.send(RUN, 150)
    assert frozen == "00 15 05 DC"  # nothing is read any more
    assert not tripped(bench)
    bench.send(RUN, 60)
    assert tripped(bench) == 18
    bench.device.link(True)
    assert bench.send(RUN, 60)[:5] == "00 02"


def test_clear_writes_zeros() -> None:
    """A reading: outputs of a Clear are zeros for the inverter, and they are a change."""
    bench = sim()
    bench.send(RUN, 1200)
    bench.device.clear(bench.now)
    bench.pass_time(100)
    assert not bench.device.motor.on
    bench.device.operate(bench.now)
    assert bench.send(RUN, 60)[:5] == "00 05"


# -- docs/reference/drives/keb-f5.md#address-and-maps-over-power-off ---------------------------------------------------


def test_k11_the_address_and_what_power_on_keeps() -> None:
    bench = sim(telegram="PCH+4/4")
    assert bench.send("72 01 20 06 00 00 00 05" + IDLE)[:23] == "42 01 20 06 00 00 00 05"
    assert bench.send("32 01 20 06 00 00 00 7F" + IDLE)[:23] == "82 01 20 06 08 00 00 30"
    assert bench.send("72 01 20 32 00 00 00 05" + IDLE)[:23] == "42 01 20 32 00 00 00 05"
    store = again(bench.device).store
    assert store.value("sy.06") == 5
    assert store.value("sy.50") == 0  # never stored
    assert store.eeprom_writes == 1
