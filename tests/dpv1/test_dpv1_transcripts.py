"""Transcripts of the masters of dpv1 with slaves that give every kind of answer.

In a file of their own: ``tools.mutants`` tries the quick texts of ``test_dpv1_texts.py`` first, and has time for more.
"""

from __future__ import annotations

import pytest
from texts import dpv1 as texts_dpv1
from texts.snapshot import lines_of, snapshot_lines


@pytest.mark.parametrize("name", texts_dpv1.TRANSCRIPTS)
def test_transcripts(name: str) -> None:
    assert lines_of({name: texts_dpv1.TRANSCRIPTS[name]}) == snapshot_lines(texts_dpv1.FILE, name)
