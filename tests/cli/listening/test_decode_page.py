"""The examples of docs/how-to/decode.md, run as they stand there."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from dpstack.cli.main import main
from dpstack.decode.filter import parse_filter

PAGE = (Path(__file__).parents[3] / "docs" / "how-to" / "decode.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"<!-- decode -->\n```text\n\$ dpstack (decode .*?)\n(.*?)```", PAGE, re.DOTALL)
((NAME, TOML),) = re.findall(r"<!-- file: (\S+) -->\n```toml\n(.*?)```", PAGE, re.DOTALL)


@pytest.mark.parametrize(("command", "printed"), EXAMPLES)
def test_an_example_prints_what_the_page_says(
    command: str,
    printed: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / NAME).write_text(TOML, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    code = main(shlex.split(command))
    assert capsys.readouterr().out == printed
    assert code == ("no telegram" in printed)


def test_the_filters_are_filters() -> None:
    (text,) = re.findall(r"<!-- filters -->\n```text\n(.*?)^```", PAGE, re.DOTALL | re.MULTILINE)
    assert len([parse_filter(line) for line in text.splitlines()]) >= 3


def test_there_are_examples_of_all_kinds() -> None:
    assert len(EXAMPLES) >= 5
