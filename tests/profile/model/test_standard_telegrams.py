"""PROFIdrive's telegrams as data: lengths as the manuals give them, signals against literal octets, N2 and N4."""

from __future__ import annotations

import pytest

from dpstack.profile import N4, standard_telegrams
from dpstack_drives.fuji import DRIVE as FUJI
from dpstack_drives.ls import DRIVE as LS


@pytest.mark.parametrize(
    ("number", "out", "into"),
    [
        (1, 2, 2),
        (2, 4, 4),
        (3, 5, 9),
        (4, 6, 14),
        (5, 9, 9),
        (7, 2, 2),
        (9, 10, 5),
        (20, 2, 6),
        (102, 6, 10),
        (103, 7, 15),
        (105, 10, 10),
    ],
)
def test_words_each_way(number: int, out: int, into: int) -> None:
    telegram = standard_telegrams.TELEGRAMS[number]
    assert (telegram.output_octets, telegram.input_octets) == (2 * out, 2 * into)


def test_telegram_1_is_n2() -> None:
    telegram = standard_telegrams.TELEGRAMS[1]
    assert telegram.pack({"STW1": 0x047F, "NSOLL_A": -0.5}).hex(" ") == "04 7f e0 00"
    assert telegram.unpack(bytes.fromhex("02 37 40 00")) == {"ZSW1": 0x0237, "NIST_A": 1.0}


def test_telegram_3_is_n4_with_an_encoder() -> None:
    telegram = standard_telegrams.TELEGRAMS[3]
    assert telegram.pack({"STW1": 0x047F, "NSOLL_B": 0.5, "G1_STW": 0x0001}).hex(" ") == "04 7f 20 00 00 00 00 00 00 01"
    assert telegram.unpack(bytes.fromhex("02 37 C0 00 00 00 00 01 00 02 00 00 10 00 FF FF FF FF")) == {
        "ZSW1": 0x0237,
        "NIST_B": -1.0,
        "ZSW2": 1,
        "G1_ZSW": 2,
        "G1_XIST1": 0x1000,
        "G1_XIST2": 0xFFFF_FFFF,
    }


def test_what_a_signal_cannot_be() -> None:
    telegram = standard_telegrams.TELEGRAMS[2]
    with pytest.raises(ValueError, match=r"outside -2\.\.2"):
        telegram.pack({"NSOLL_B": 2.1})
    with pytest.raises(ValueError, match="STW2 is an integer of 16 bits"):
        telegram.pack({"STW2": 0x1_0000})
    with pytest.raises(KeyError, match="G1_STW"):
        telegram.pack({"G1_STW": 1})
    assert telegram.unpack(bytes.fromhex("02 37 40")) == {"ZSW1": 0x0237}  # too short: what there is


@pytest.mark.parametrize(("value", "raw"), [(1.0, 0x4000_0000), (-1.0, 0xC000_0000), (-2.0, 0x8000_0000), (0, 0)])
def test_n4(value: float, raw: int) -> None:
    assert N4.encode(value) == raw
    assert N4.decode(raw) == value


def test_the_ppo_types_of_the_drives() -> None:
    for drive in (FUJI, LS):
        for name, (octets, channel) in standard_telegrams.PPO.items():
            spec = drive.telegrams.get(name)
            if spec is not None:
                assert (spec.outputs, spec.inputs, spec.channel) == (octets, octets, channel)
