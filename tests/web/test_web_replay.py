"""A recording on the page, in place of a bus."""

from __future__ import annotations

from collections.abc import AsyncIterator
from pathlib import Path

import pytest

from dpstack.cli.main import main
from dpstack.web import source
from dpstack.web.source import ReplaySource
from dpstack.web.web_server import serve
from tests.web.web_kit import PLANT, page_of

#: a CSV file of somebody else: no description, one unit
LINES = """time,t,boiler.state,boiler.level [bar]
2026-01-31T12:00:00.000Z,0.0,data_exchange,12.3
2026-01-31T12:00:00.020Z,0.02,data_exchange,12.4
2026-01-31T12:00:00.040Z,0.04,offline,
"""


async def test_a_recording_is_shown_to_its_end_and_described(tmp_path: Path) -> None:
    path = tmp_path / "plant.csv"
    path.write_text(LINES, encoding="utf-8")
    async with serve(ReplaySource(path)) as server, page_of(server) as page:
        assert (await page.until("welcome"))["source"] == "replay"
        assert [slave["name"] for slave in (await page.until("plant"))["slaves"].values()] == ["boiler"]
        values = [slave["fields"]["level"] for slave in (await page.until("snapshot"))["slaves"].values()]
        assert values in ([12.3], [12.4], [None])
        assert "plant.csv" in (await page.until("end"))["text"]
        described = (await page.ask("recording"))["result"]
        assert (described["file"], described["seconds"]) == ("plant.csv", 0.04)
        assert described["started"] == 1_769_860_800.0
        assert [(one["name"], one["kind"], one["unit"]) for one in described["columns"]] == [
            ("boiler.state", None, ""),
            ("boiler.level", None, "bar"),
        ]
        assert "there is no run" in (await page.ask("why", "boiler"))["error"]
        assert (await page.order("operate"))["ok"] is False
        async with page_of(server) as late:  # the last values stay, marked as ended
            assert (await late.until("snapshot"))["whole"] is True
            await late.until("end")


async def test_an_invalid_item_of_a_recording_is_left_out_and_reported_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "plant.csv"
    path.write_text(LINES, encoding="utf-8")

    async def replayed(_: Path) -> AsyncIterator[dict[str, object]]:
        for item in [{"plant": {"slaves": {}, "baud": "fast"}}, {"plant": {"slaves": {}, "baud": "fast"}}, PLANT]:
            yield item

    monkeypatch.setattr(source, "replay_items", replayed)
    log: list[str] = []
    async with serve(ReplaySource(path), log=log.append) as server, page_of(server) as page:
        assert await page.until("plant") == PLANT["plant"]
    assert [line.partition(" ")[2] for line in log] == [
        "this is no item of the stream: Expected `int | null`, got `str` - at `$.plant.baud`; "
        "is the other program another version?"
    ]


@pytest.mark.parametrize(("text", "why"), [(None, "plant.csv"), ("no recording", "plant.csv")])
def test_a_file_that_is_no_recording_is_one_line(
    text: str | None, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "plant.csv"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    assert main(["web", "--replay", str(path), "--listen", "0"]) == 2
    err = capsys.readouterr().err
    assert why in err
    assert err.count("\n") == 1
