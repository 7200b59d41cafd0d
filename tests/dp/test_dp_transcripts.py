"""Transcripts of the masters of dp with slaves that give every kind of answer.

In a file of their own: ``tools.mutants`` tries the quick texts of ``test_dp_texts.py`` first, and has time for more.
"""

from __future__ import annotations

import pytest
from texts import dp as texts_dp
from texts.snapshot import lines_of, snapshot_lines


@pytest.mark.parametrize("name", texts_dp.TRANSCRIPTS)
def test_transcripts(name: str) -> None:
    assert lines_of({name: texts_dp.TRANSCRIPTS[name]}) == snapshot_lines(texts_dp.FILE, name)
