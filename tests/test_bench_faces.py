"""The benchmark of the faces: surroundings that cannot be made here."""

from __future__ import annotations

import pytest

from bench.plant import faces


def test_without_mosquitto_the_surroundings_that_need_it_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    notes: list[str] = []
    monkeypatch.setattr(faces, "mosquitto", lambda: None)
    assert faces.possible(faces.AROUND, notes) == ["gone", "stuck", "hostile", "full"]
    assert notes == ["well, stopped, greedy, backlog: left out, mosquitto is not installed"]
    assert faces.possible(["gone"], notes) == ["gone"]
    monkeypatch.setattr(faces, "mosquitto", lambda: "/usr/sbin/mosquitto")
    assert faces.possible(["gone", "well"], notes) == ["gone", "well"]
    assert len(notes) == 1
