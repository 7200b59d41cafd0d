"""JSON lines of telegrams that repeat themselves: what is kept makes no difference, for any traffic."""

from __future__ import annotations

import io
from collections.abc import Iterable
from pathlib import Path

import msgspec
import pytest
from changed_traffic import BAUD, EPOCH, recorded, traffic
from hypothesis import example, given, settings
from recordings import ASM754, WHOLE

from dpstack.capture.transmission import Transmission
from dpstack.cli.listening.telegram_lines import JsonLines
from dpstack.decode import telegram as telegram_module
from dpstack.decode.names import Names, SlaveNames
from dpstack.decode.source import read_transmissions
from dpstack.decode.telegram import Explainer, explain

NAMED = Names({3: SlaveNames(name="pump"), 4: SlaveNames(name="Mühle")}, lambda ident, config: None, lambda *_: {})


def as_kept(transmissions: Iterable[Transmission], encoding: str) -> list[str]:
    explainer, lines = Explainer(NAMED), JsonLines(encoding)
    return [lines.line(explainer.add(one)) for one in transmissions]


def as_new(transmissions: Iterable[Transmission], encoding: str) -> list[str]:
    """Each telegram judged and written as if it were the first one."""
    explainer = Explainer(NAMED)
    found = []
    for one in transmissions:
        explainer._known.clear()
        found.append(JsonLines(encoding).line(explainer.add(one)))
    return found


@settings(max_examples=25)
@given(recorded())
@example([list(traffic())])
def test_lines_of_a_bus_are_those_of_each_telegram_by_itself(batches: list[list[Transmission]]) -> None:
    heard = [one for batch in batches for one in batch]
    assert as_kept(heard, "utf-8") == as_new(heard, "utf-8")


@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_lines_of_recordings_are_those_of_each_telegram_by_itself(encoding: str) -> None:
    with (Path(__file__).parents[2] / "examples/bus.sr").open("rb") as file:
        heard = list(read_transmissions(file, "bus"))
    for recording in (*WHOLE, ASM754):
        heard += [Transmission(octets, EPOCH + n * 997_123, BAUD) for n, (_, octets) in enumerate(recording.lines)]
    heard += [*traffic(), *traffic()]
    assert as_kept(heard, encoding) == as_new(heard, encoding)


@pytest.mark.parametrize("t_ns", [0, 1, 999_999, 1_000_000, 2**53 + 1, 10**24 - 1, 10**24, 10**27])
def test_times_of_any_size_are_written_in_one_way(t_ns: int) -> None:
    ends = [one.octets for one in traffic()[-20:]]
    heard = [Transmission(one, t_ns + n, BAUD) for n in range(3) for one in ends]
    lines = JsonLines("utf-8")
    for one in explain(heard):
        assert lines.line(one).encode() == msgspec.json.encode(one.as_dict())


def test_telegrams_that_never_repeat_do_not_fill_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(telegram_module, "_KEPT_TELEGRAMS", 16)
    monkeypatch.setattr("dpstack.cli.listening.telegram_lines._KEPT_LINES", 16)
    explainer, lines = Explainer(), JsonLines("utf-8")
    octets = io.BytesIO(b"".join(b"10 %02x 02 49 %02x 16\n" % (da, da + 75 & 255) for da in range(126)))
    for one in (*read_transmissions(octets, "hex"), *traffic(), *traffic()):
        lines.line(explainer.add(one))
        assert max(len(explainer._known), len(lines._kept), len(lines._seen)) <= 16
    assert lines._kept
