"""A configuration file that changes while a run and its page are open: both are told, and the run keeps its own."""

from __future__ import annotations

import asyncio
import hashlib
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from dpstack.api.config.config import file_digest, load_config
from dpstack.api.control.commands import KINDS
from dpstack.api.control.control_server import ControlServer
from dpstack.web import run_source
from dpstack.web.run_source import RunSource
from dpstack.web.web_server import serve
from tests.web.web_kit import PLANT, WHOLE, page_of

TEXT = '[bus]\nport = "virtual"\nbaud = 500000\n# ümlaut\n'


@pytest.fixture(autouse=True)
def runtime(runtime_directory: str, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with tempfile.TemporaryDirectory(prefix="t", dir=runtime_directory) as path:
        monkeypatch.setenv("XDG_RUNTIME_DIR", path)
        yield


async def test_the_page_is_told_that_the_file_has_changed_since_the_run_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_source, "_FILE_S", 0.01)
    file = tmp_path / "plant.toml"
    file.write_text(TEXT, encoding="utf-8")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    plant = {"plant": {**PLANT["plant"], "config": str(file), "config_digest": digest}}

    def live(_args: list[str]) -> object:
        async def stream(send: Any) -> None:
            await send(plant)
            await send(WHOLE)
            await asyncio.Event().wait()

        return stream

    async with ControlServer("run", "COM7", KINDS["run"], {"live": live}):
        file.write_text(TEXT + "# changed before the page was opened\n", encoding="utf-8")
        async with serve(RunSource.named("COM7")) as server, page_of(server) as page:

            async def told(part: str) -> None:
                while part not in (await page.until("event"))["text"]:
                    pass

            await told(f"{file} has changed since this run began; the run keeps what it has read")
            file.write_text(TEXT, encoding="utf-8")
            await told("is again as this run has read it")
            file.unlink()
            await told("cannot be read any more")
            async with page_of(server) as late:  # a page that is opened later has the events, too
                while "cannot be read any more" not in (await late.until("event"))["text"]:
                    pass


def test_a_configuration_knows_what_was_read(tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_bytes(b"\xef\xbb\xbf" + TEXT.encode())  # an editor's mark is no change
    config = load_config(file)
    assert config.digest == hashlib.sha256(TEXT.encode()).hexdigest() == file_digest(file)
    file.write_text(TEXT.replace("500000", "187500"), encoding="utf-8")
    assert config.digest != file_digest(file)
    assert config.with_bus(baud=9600).digest == config.digest
    file.write_bytes(b"\xff")
    assert file_digest(file) is None
    assert file_digest(tmp_path) is None
