"""Texts of the diagnosis, from literal octets of blocks."""

from __future__ import annotations

import pytest
from gsd_kit import device

from dpstack.gsd.diag_texts import DiagTexts

D = device("diagnosis")
TEXTS = DiagTexts(D, [None, D.modules[0]])


@pytest.mark.parametrize(
    ("octets", "texts"),
    [
        ("", ()),
        ("00", ()),
        ("01", ("fuse blown",)),
        ("00 06", ("too hot",)),
        ("00 00", ("no load voltage",)),
        ("00 04 05", ()),
        ("01 02 00 00", ("fuse blown", "too hot", "no load voltage", "runs")),
        ("00 04 19 08", ("stopped", "across the octets")),
        ("81 04 05 01", ("parity",)),
        ("80 04 05 01", ()),
    ],
)
def test_device_related(octets: str, texts: tuple[str, ...]) -> None:
    assert TEXTS.unit_diag_texts(bytes.fromhex(octets)) == texts


def test_helps_go_with_the_texts() -> None:
    octets = bytes.fromhex("01 04 09 00")
    assert TEXTS.unit_diag_texts(octets) == ("fuse blown", "stopped")
    assert TEXTS.unit_diag_helps(octets) == ("replace F1", "start it")


def test_channel_related() -> None:
    assert (TEXTS.channel_text(16), TEXTS.channel_help(16)) == ("sensor missing", "plug it in")
    assert (TEXTS.channel_text(17), TEXTS.channel_help(17)) == (None, None)


def test_a_modules_own_texts_come_first() -> None:
    assert TEXTS.channel_text(16, module=1) == "coil open"
    assert TEXTS.channel_text(16, module=0) == "sensor missing"
    assert TEXTS.channel_text(16, module=99) == "sensor missing"
    assert TEXTS.unit_diag_texts(b"\x01", module=1) == ("module fuse",)
