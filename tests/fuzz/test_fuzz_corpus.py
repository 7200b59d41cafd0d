"""Every input of every target's corpus passes. The frame writes finds as files and repairs mutated inputs."""

from __future__ import annotations

import random
from pathlib import Path

import pytest

from tests.fuzz import frame
from tests.fuzz.frame import MAX_LEN, Cutter, Finds, Target, TooSlowError, by_hand, corpus, load, mutated, names
from tools import fuzz


@pytest.mark.parametrize("name", names())
def test_corpus_passes(name: str) -> None:
    target = load(name)
    files = corpus(name)
    assert files, f"tests/fuzz/corpus/{name} is empty: python -m tools.fuzz {name} --minimise FOLDER"
    for path in files:
        target.once(path.read_bytes())


def test_every_corpus_has_its_target_and_small_files() -> None:
    assert {path.name for path in frame.CORPUS.iterdir()} <= set(names())
    sizes = {path: path.stat().st_size for name in names() for path in corpus(name)}
    assert not {path: size for path, size in sizes.items() if size > 2_000}


class BoomError(Exception):
    """An error that no target allows."""


def _fails_on_z(octets: bytes) -> None:
    if b"z" in octets:
        raise BoomError(octets)
    if b"q" in octets:
        raise ValueError(octets)


def test_a_find_is_a_file_and_the_same_one_is_written_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    target = Target(_fails_on_z, covers=(), allowed=(ValueError,))
    finds = Finds("planted", tmp_path)
    report = by_hand(target, finds, [b"abcdefy"], executions=5_000, seconds=60, seed=1)
    assert report.executions == 5_000
    (path,) = finds.files
    assert path.name.startswith("planted-BoomError-")
    assert b"z" in path.read_bytes()
    assert f"find {path}" in capsys.readouterr().out
    assert fuzz.replay("planted", target, [path]) == 1
    assert "BoomError" in capsys.readouterr().out
    path.write_bytes(b"q")
    assert fuzz.replay("planted", target, [path]) == 0


def test_an_input_that_takes_too_long_is_a_find() -> None:
    with pytest.raises(TooSlowError, match="for 3 octets"):
        Target(lambda octets: sum(range(20_000)), covers=(), slow_s=0).once(b"abc")


def test_mutations_repeat_with_their_seed_and_most_are_repaired() -> None:
    target = Target(len, covers=(), repair=lambda octets: b"!" + octets[1:])

    def made(seed: int) -> list[bytes]:
        chance = random.Random(seed)
        return [target.mended(mutated(b"abcdef" * 40, [b"other"], (b"word",), chance), chance) for _ in range(300)]

    assert made(3) == made(3) != made(4)
    assert max(map(len, made(3))) <= MAX_LEN
    assert 200 < sum(octets[:1] == b"!" for octets in made(3)) < 280
    assert any(b"word" in octets for octets in made(3))


def test_replay_of_an_unknown_target_names_the_known_ones(capsys: pytest.CaptureFixture[str]) -> None:
    assert fuzz.main(["no-such-target", "--executions", "1"]) == 2
    assert "decoder" in capsys.readouterr().err


def test_cutter_answers_zero_and_nothing_at_the_end() -> None:
    cutter = Cutter(b"\x01\x02\x03\x02ab\x05c")
    assert (cutter.octet(), cutter.word()) == (1, 0x0203)
    assert list(cutter.pieces()) == [b"ab", b"c"]
    assert (cutter.octet(), cutter.word(), cutter.rest()) == (0, 0, b"")
