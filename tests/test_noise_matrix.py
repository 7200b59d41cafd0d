"""The matrix of noise x baud x stations is what it was; see :mod:`noise_matrix`."""

from __future__ import annotations

import difflib
import json

import pytest
from noise_matrix import path_of, text_of


def compare(name: str) -> None:
    kept, found = path_of(name).read_text(), text_of(name)
    diff = list(difflib.unified_diff(kept.splitlines(), found.splitlines(), "kept", "found", n=0, lineterm=""))
    if diff:
        advice = (
            "read the diff; when it is meant, run: python tests/kits/noise_matrix.py --soak, and say why in the commit"
        )
        pytest.fail("\n".join([f"the behaviour under noise has changed ({len(diff)} lines)", *diff, advice]))


def test_noise() -> None:
    compare("noise")


@pytest.mark.soak
def test_noise_at_every_rate() -> None:
    compare("noise_soak")


@pytest.mark.parametrize("name", ["noise", "noise_soak"])
def test_no_wrong_octet_ever_reached_the_application_and_every_bus_came_back(name: str) -> None:
    rows = json.loads(path_of(name).read_text())
    assert len(rows) >= 36
    for title, row in rows.items():
        assert row["wrong inputs"] == 0, title
        assert row["back after ms"] != "never", title
        if ", 0 per bit" in title:
            assert set(row) == {"exchanges", "wrong inputs", "back after ms"}, title
