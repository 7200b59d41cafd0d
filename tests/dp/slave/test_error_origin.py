"""Where an exception in a device comes from, whatever the author's files are called."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest
from slave_kit import Bench

from dpstack.dp.error_origin import DEVICE_CALL, origin_of
from dpstack.dp.slave.device import DpV0Device
from dpstack.dp.slave.events import DeviceFailed

_DEVICE = """
import asyncio
from dpstack.dp.pdu.diag_blocks import channel_block
from dpstack.dp.slave.device import DpV0Device

class Mine(DpV0Device):
    configs = (b"\\x10\\x20",)
    ident = 0x0A35

    def exchange(self, outputs, now):
        return self.{how}(outputs)

    def by_itself(self, outputs):
        return bytes([1 // 0])

    def with_help(self, outputs):
        channel_block(slot=500, channel=500, error=500)

    def in_a_loop(self, outputs):
        asyncio.run(self.late())

    def wrong_length(self, outputs):
        return bytes(9)

    async def late(self):
        raise ValueError("late")
"""
OURS = ["record_requests.py", "state.py", "dpstack/dp/slave/application.py", "dpstack/api/slave_side/async_device.py"]


def load(path: Path, text: str) -> ModuleType:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", OURS)
@pytest.mark.parametrize(
    ("how", "origin"),
    [("by_itself", "by_itself()"), ("with_help", "with_help()"), ("in_a_loop", "late()"), ("wrong_length", "")],
)
def test_it_is_the_last_line_of_the_author(name: str, how: str, origin: str, tmp_path: Path) -> None:
    device: DpV0Device = load(tmp_path / name, _DEVICE.replace("{how}", how)).Mine()
    bench = Bench(device).up()
    bench.dx()
    (failed,) = [event for event in bench.app.take_events() if isinstance(event, DeviceFailed)]
    file = Path(name).name
    assert failed.origin.startswith(f"{origin}, {file} line " if origin else "")
    assert bool(failed.origin) == bool(origin)


def test_an_exception_raised_around_a_call_is_not_the_authors() -> None:
    with pytest.raises(ValueError, match="ours") as caught:
        raise ValueError("ours")
    assert origin_of(caught.value) == ""
    with pytest.raises(TypeError) as inside, DEVICE_CALL:
        len(3)  # type: ignore[arg-type]
    assert origin_of(inside.value) == ""
