"""The makers' printed status octets, held to the two tables of :mod:`dpstack.plant.status_octet`."""

from __future__ import annotations

import pytest

from dpstack.plant.quality import Reason
from dpstack.plant.status_octet import CLASSIC, CONDENSED, read_status
from tests.pa.makers_octets import STATUS, Status


def octets_of(row: Status) -> range:
    first, _, last = row.octets.partition("-")
    return range(int(first, 16), int(last or first, 16) + 1)


@pytest.mark.parametrize(
    "row", STATUS, ids=lambda row: f"{row.source.device}-{row.coding}-{row.octets}".replace(" ", "-")
)
def test_printed_status(row: Status) -> None:
    for octet in octets_of(row):
        reason, text = read_status(row.coding, octet)
        assert reason.quality.value == row.quality, (hex(octet), text)
        assert row.says in text, (hex(octet), text)
        if not row.says:
            assert (reason, text) == (Reason.GOOD, ""), hex(octet)


def test_makers() -> None:
    """Enough of them, in both codings; misprints are known ones."""
    makers = {(row.coding, row.source.maker) for row in STATUS}
    assert len({maker for _, maker in makers}) >= 6
    assert {coding for coding, _ in makers} == {CLASSIC, CONDENSED}
    assert [row.misprint for row in STATUS if row.misprint] == ["1C", "86", "45", "25"]
