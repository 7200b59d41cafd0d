"""The texts in docs/how-to/symptoms.md are those that dpstack has for the plants of the symptoms."""

from __future__ import annotations

import pytest

from tests.why.symptom_plants import BLOCK, PAGE, PLANTS, TEXTS, text_of

SHOWN = {name: text for _, name, text in BLOCK.findall(PAGE.read_text(encoding="utf-8"))}


def test_the_page_shows_every_symptom() -> None:
    assert sorted(SHOWN) == sorted([*PLANTS, *TEXTS])


@pytest.mark.parametrize("name", SHOWN)
def test_a_symptom_gets_the_text_of_the_page(name: str) -> None:
    assert text_of(name) == SHOWN[name], "run python tests/why symptoms"
