"""Texts of the diagnosis, from literal octets of blocks."""

from __future__ import annotations

import pytest
from gsd_kit import device

from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import DiagText

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
    assert tuple(found.text for found in TEXTS.unit_diag_texts(bytes.fromhex(octets))) == texts


def test_helps_go_with_the_texts() -> None:
    found = TEXTS.unit_diag_texts(bytes.fromhex("01 04 09 00"))
    assert [(text.text, text.help) for text in found] == [("fuse blown", "replace F1"), ("stopped", "start it")]


def test_channel_related() -> None:
    assert TEXTS.channel_text(16) == DiagText("channel", None, None, 16, "sensor missing", "plug it in")
    assert TEXTS.channel_text(17) is None


@pytest.mark.parametrize(("module", "text"), [(1, "coil open"), (0, "sensor missing"), (99, "sensor missing")])
def test_a_modules_own_channel_texts_come_first(module: int, text: str) -> None:
    found = TEXTS.channel_text(16, module)
    assert found is not None
    assert found.text == text


def test_a_modules_own_unit_texts_come_first() -> None:
    assert [found.text for found in TEXTS.unit_diag_texts(b"\x01", module=1)] == ["module fuse"]
