"""Plain JSON topics of `dpstack run` as mosquitto_sub sees them: values, an order, a refused one, the will."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from edge_node_rig import GROUP, NODE
from test_mosquitto import CONFIG, LONGEST_S, Mosquitto, run

pytestmark = pytest.mark.strangers
BASE = f"dpstack/{GROUP}/{NODE}"


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    made = Mosquitto(tmp_path)
    yield made
    made.kill()


async def message(broker: Mosquitto, topic: str, *options: str) -> tuple[bool, Any]:
    """The next message: whether the broker had kept it, and its payload."""
    words = broker.clients("mosquitto_sub", "-t", f"{BASE}/{topic}", "-C", "1", "-W", "20", "-F", "%r %p", *options)
    made = await asyncio.to_thread(subprocess.run, words, check=True, capture_output=True, timeout=LONGEST_S)
    kept, _, payload = made.stdout.decode().partition(" ")
    return kept == "1", json.loads(payload)


async def until(broker: Mosquitto, topic: str, wanted: str) -> Any:
    end = time.monotonic() + LONGEST_S
    while wanted not in json.dumps((found := await message(broker, topic))[1]):
        assert time.monotonic() < end, found
    return found[1]


async def order(broker: Mosquitto, name: str, payload: object) -> Any:
    """Send an order; returns its result."""
    before = broker.subscriptions()
    listening = asyncio.create_task(message(broker, "result"))
    while broker.subscriptions() == before:  # noqa: ASYNC110  the log of the broker tells nobody
        await asyncio.sleep(0.02)
    topic = f"{BASE}/slave/valves/set/{name}"
    await run(broker.clients("mosquitto_pub", "-q", "1", "-t", topic, "-m", json.dumps(payload)))
    kept, result = await listening
    assert not kept
    return result


async def test_the_whole_way(tmp_path: Path, broker: Mosquitto) -> None:
    config = tmp_path / "plant.toml"
    config.write_text(CONFIG.format(port=broker.port, group=GROUP, node=NODE) + 'format = "json"\n')
    run_ = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "dpstack", "run", str(config)),
        env=os.environ | {"XDG_STATE_HOME": str(tmp_path)},
        stdout=asyncio.subprocess.DEVNULL,
    )
    try:
        await until(broker, "slave/valves/online", "true")
        await until(broker, "online", "true")
        level = (await until(broker, "slave/valves/inputs", '"good"'))["level"]
        assert level["time"].endswith("Z")
        kept = broker.clients("mosquitto_sub", "-t", f"{BASE}/slave/valves/inputs", "-C", "1", "-F", "%E")
        made = await asyncio.to_thread(subprocess.run, kept, check=True, capture_output=True, timeout=LONGEST_S)
        assert 0 < int(made.stdout) <= 30
        result = await order(broker, "lamp", {"value": True, "time": time.time()})
        assert (result["order"], result["result"]) == ("valves.lamp", "done"), result
        await until(broker, "slave/valves/outputs", '"lamp": {"value": true')
        result = await order(broker, "speed", {"value": 1, "time": time.time()})
        assert result["reason"] == "there is no such order, or allow_commands does not list it"
        result = await order(broker, "lamp", {"value": False, "time": time.time() - 60})
        assert "s old by the clock of this computer" in result["reason"]
        run_.kill()
        await run_.wait()
        assert await until(broker, "online", "false") is False
    finally:
        if run_.returncode is None:
            run_.kill()
            await run_.wait()
