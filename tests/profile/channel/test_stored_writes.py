"""The limit of writes that a drive stores in its EEPROM, over PKW, makers' own channels and record 47."""

from __future__ import annotations

from typing import Any

import pytest
from api_kit import device_of, in_virtual_time, running

from dpstack.errors import ParameterError
from dpstack.profile import CommandError, ParamSpec, StoredWrites
from dpstack.profile.channel import stored_writes

MINUTE = 60_000_000_000


def test_a_hundred_writes_at_once_then_one_a_minute() -> None:
    book = StoredWrites()
    now = 5
    for _ in range(100):
        book.admit(480, "parameter 480", now)
    for _ in range(3):
        with pytest.raises(
            CommandError, match=r"parameter 480: was written 100 times .* the next one in 60 s"
        ) as found:
            book.admit(480, "parameter 480", now)
        assert found.value.kind == "parameter"
    book.admit(481, "another one", now)
    day = 0
    for _ in range(24 * 60 * 6):
        now += MINUTE // 6
        try:
            book.admit(480, "parameter 480", now)
        except CommandError:
            continue
        day += 1
    assert day == 24 * 60
    now += 100 * MINUTE
    for _ in range(100):
        book.admit(480, "parameter 480", now)


def test_a_volatile_parameter_has_no_limit_and_old_ones_are_forgotten() -> None:
    book = StoredWrites()
    for _ in range(500):
        book.admit(1, "S06", 0, ParamSpec(1, "S06", "Operation command", volatile=True))
    assert not book._full_at
    for number in range(5_000):
        book.admit(number, "some", number * MINUTE)
    assert len(book._full_at) < 1_100


@pytest.mark.parametrize(
    ("kind", "telegram", "number", "spared", "other"),
    [
        ("demag-dedrive", "PPO1", 480, {"number": 480, "ram": True}, {"number": 480, "data_set": 2}),
        ("fuji-frenic", "PPO1", "F07", {"number": "S06", "value": 0}, {"number": "F08"}),
        ("keb-f5", "PCH+8/8", "oP.28", {"number": "sy.50", "value": 0}, {"number": "oP.28", "data_set": 1}),
        ("imo-hd2", "PKW+12", "P00.11", None, {"number": "P00.12"}),
        ("ls-s100", "PPO3", "dr-03", None, {"number": "dr-04"}),
    ],
)
@in_virtual_time
async def test_each_drive_spares_its_eeprom(
    kind: str,
    telegram: str,
    number: int | str,
    spared: dict[str, Any] | None,
    other: dict[str, Any],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(stored_writes, "BURST", 2)
    async with running({"name": "it", "address": 6, "drive": kind, "telegram": telegram}, 1_500_000) as (bus, drive):
        store = device_of(bus, 6).store
        before = store.eeprom_writes
        await drive.write(number, 2.0)
        await drive.write(number, 3.0)
        counted = store.eeprom_writes
        assert counted > before
        with pytest.raises(ParameterError, match=r"wears out the EEPROM of the drive; the next one in \d+ s"):
            await drive.write(number, 4.0)
        assert store.eeprom_writes == counted
        for one in (other, other, *(3 * [spared] if spared else [])):
            await drive.write(**{"value": 2.0, **one})
