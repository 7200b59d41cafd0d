"""The benchmarks of the machines themselves: with tiny numbers they run and give what they document."""

from __future__ import annotations

import sys

import pytest

from bench import codec, listen, scale, virtual
from bench.null_medium import NullBus
from bench.report import Report
from dpstack.decode.words import describe_octets


def figures(report: Report) -> dict[str, float]:
    return {figure.name: figure.value for figure in report.figures}


def test_codec_measures_every_kind_of_telegram_both_ways() -> None:
    values = figures(codec.run(["--loops", "4", "--rounds", "2"]))
    for kind in ("SD1 FDL status", "SD2 Data_Exchange, PPO1", "SD2 diagnosis", "SD4 token", "SC"):
        for does in ("encode", "decode"):
            assert f"{kind}: {does}, dpstack" in values
            assert f"{kind}: {does}, construct to dpstack" in values
    assert "SD3: decode, dpstack" in values
    assert "SD3: encode, dpstack" not in values  # never sent


def test_codec_without_pyprofibus_says_so_and_measures_the_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyprofibus", None)
    monkeypatch.setitem(sys.modules, "pyprofibus.fdl", None)
    report = codec.run(["--loops", "4", "--rounds", "1"])
    assert "pyprofibus is not installed and left out: python -m pip install -e '.[bench]'" in report.notes
    assert not [name for name in figures(report) if "pyprofibus" in name]
    assert "SC: decode, construct" in figures(report)


def test_codec_notices_who_makes_other_octets(monkeypatch: pytest.MonkeyPatch) -> None:
    wrong = codec.SAMPLES[0]._replace(octets=bytes.fromhex("10 03 02 49 4F 16"))
    monkeypatch.setattr(codec, "SAMPLES", (wrong,))
    with pytest.raises(RuntimeError, match="dpstack makes other octets of SD1 FDL status"):
        codec.run(["--loops", "1", "--rounds", "1"])


def test_scale_gives_the_cost_of_an_exchange_and_of_one_slave_more() -> None:
    report = scale.run(["--slaves", "3", "--exchanges", "30", "--rounds", "1", "--seconds", "0"])
    values = figures(report)
    assert set(values) == {
        "Python calibration",
        "no medium, 1 slave: CPU time per exchange",
        "no medium, 3 slaves: CPU time per exchange",
        "no medium, 3 slaves: CPU time per exchange to one slave's",
        "no medium, 3 slaves: CPU time of one slave more",
    }
    assert report.notes == ["without a pty"]


def test_scale_over_a_pty() -> None:
    values = figures(
        scale.run(["--slaves", "1", "--exchanges", "9", "--rounds", "1", "--seconds", "0.1", "--pty-rounds", "1"])
    )
    assert values["pty, 1 slave: CPU time per exchange"] > 0


def test_virtual_measures_drives_and_mirrors_under_the_referee() -> None:
    values = figures(virtual.run(["--drives", "2", "--slaves", "1", "2", "--rounds", "1", "--ms", "20"]))
    assert set(values) == {
        "Python calibration",
        "2 demag-dedrive, PPO1: CPU time of a simulated second",
        "2 demag-dedrive, PPO1: CPU per exchange, both ends and the wire",
        "2 demag-dedrive, PPO1, running: CPU time of a simulated second",
        "2 demag-dedrive, PPO1, running: CPU per exchange, both ends and the wire",
        "1 mirror: CPU time of a simulated second",
        "1 mirror: CPU per exchange, both ends and the wire",
        "2 mirrors: CPU time of a simulated second",
        "2 mirrors: CPU per exchange, both ends and the wire",
        "CPU per exchange, 2 mirrors to 1",
        "CPU per exchange with a Global_Control in each round, to 2 mirrors to that to 1",
    }
    assert values["1 mirror: CPU time of a simulated second"] > 0


def test_the_medium_without_cost_brings_everybody_into_data_exchange_and_keeps_the_rules() -> None:
    bus = NullBus(5)
    bus.bring_up()
    begun = bus.exchanges
    assert bus.measure(50) > 0
    assert bus.exchanges - begun == 50
    for address, image in bus.master.images.items():
        assert image.inputs == bytes((address,) * 12)
        assert image.outputs[0] == bus.master.rounds & 0xFF  # other ones in every round
    assert not bus.station.stats.late
    assert bus.station.decoder_stats.bad == 0
    with pytest.raises(ValueError, match="1 to 122 are possible"):
        NullBus(0)


def test_listening_measures_every_step_on_the_telegrams_of_a_realistic_bus() -> None:
    report = listen.run(["--telegrams", "600", "--rounds", "1"])
    goals = {figure.name: figure.goal for figure in report.figures if figure.goal is not None}
    assert goals == {
        "writing pcapng, to the codec's decode": 1.5,
        "monitor FILE, to the codec's decode": 10.0,
        "decode --json FILE, to the codec's decode": 30.0,
    }
    assert figures(report)["a full bus at 12 Mbit/s"] > 20_000
    heard = listen.traffic(3_000)
    seen = {describe_octets(one.octets).partition(" ")[0] for one in heard}
    assert seen >= {"token", "FDL_Status", "Set_Prm", "Chk_Cfg", "Slave_Diag", "Global_Control", "Data_Exchange", "MS1"}
    for batch_ns in (0, 1_000_000):
        assert b"".join(octets for octets, _ in listen.chunks(heard, batch_ns)) == b"".join(one.octets for one in heard)
