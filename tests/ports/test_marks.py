"""The marks of damaged characters, by the octets of termios(3)."""

from __future__ import annotations

import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.ports.tty import Unmarker

#: delivered, intact, damaged, odd
CASES = [
    ("", "", 0, 0),
    ("6809096803027d16", "6809096803027d16", 0, 0),
    ("68ffff0016", "68ff0016", 0, 0),  # as measured on a tty: a genuine FF is doubled
    ("ff0068", "", 1, 0),
    ("10ff000316", "1016", 1, 0),
    ("ff00ff16", "16", 1, 0),  # the damaged octet is FF itself: it is not doubled in a mark
    ("ff0000", "", 1, 0),
    ("ffffff0003ffff", "ffff", 1, 0),
    ("ff03e5", "ff03e5", 0, 1),
    ("ffffffff", "ffff", 0, 0),
]


@pytest.mark.parametrize(("delivered", "intact", "damaged", "odd"), CASES)
def test_marks_cut_at_any_place_are_read(delivered: str, intact: str, damaged: int, odd: int) -> None:
    octets = bytes.fromhex(delivered)
    cuts = range(len(octets) + 1)
    for first, second in itertools.combinations_with_replacement(cuts, 2):
        unmarker = Unmarker()
        chunks = (octets[:first], octets[first:second], octets[second:])
        assert b"".join(unmarker.feed(chunk) for chunk in chunks).hex() == intact
        assert (unmarker.damaged, unmarker.odd) == (damaged, odd)


def test_a_mark_that_has_begun_is_forgotten_when_the_line_is_opened_anew() -> None:
    for begun in ("ff", "ff00"):
        unmarker = Unmarker()
        assert unmarker.feed(bytes.fromhex("e5" + begun)) == b"\xe5"
        unmarker.reset()
        assert unmarker.feed(b"\x00\x16") == b"\x00\x16"
        assert unmarker.damaged == 0


def test_a_chunk_without_ff_is_not_copied() -> None:
    chunk = bytes(range(200))
    assert Unmarker().feed(chunk) is chunk


@given(st.lists(st.tuples(st.integers(0, 255), st.booleans())), st.data())
def test_the_marks_of_a_tty_are_undone(characters: list[tuple[int, bool]], data: st.DataObject) -> None:
    wire = bytearray()
    for octet, good in characters:
        if not good:
            wire += bytes((0xFF, 0, octet))
        elif octet == 0xFF:
            wire += b"\xff\xff"
        else:
            wire.append(octet)
    unmarker = Unmarker()
    kept = bytearray()
    while wire:
        size = data.draw(st.integers(1, len(wire)))
        kept += unmarker.feed(bytes(wire[:size]))
        del wire[:size]
    assert bytes(kept) == bytes(octet for octet, good in characters if good)
    assert unmarker.damaged == sum(not good for _, good in characters)
