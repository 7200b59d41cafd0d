"""Monitors process variables with ``aioca`` or ``pyepics``, and writes a JSON line for each value and connection.

``python epics_client.py LIBRARY NAME...``, in an environment of its own.
"""

from __future__ import annotations

import asyncio
import json
import sys
import time
from typing import Any

LIBRARY, *NAMES = sys.argv[1:]


def say(name: str, connected: bool, **more: Any) -> None:
    print(json.dumps({"name": name, "connected": connected} | more), flush=True)


async def with_aioca() -> None:
    import aioca

    def update(value: Any, number: int) -> None:
        if not value.ok:
            say(NAMES[number], connected=False)
        else:
            say(NAMES[number], connected=True, value=float(value), severity=value.severity, status=value.status,
                time=value.timestamp)  # fmt: skip

    aioca.camonitor(NAMES, update, format=aioca.FORMAT_TIME, notify_disconnect=True, all_updates=True)
    await asyncio.Event().wait()


def with_pyepics() -> None:
    import epics

    def update(pvname: str, value: Any, severity: int, status: int, timestamp: float, **_: Any) -> None:
        say(pvname, connected=True, value=float(value), severity=severity, status=status, time=timestamp)

    def connection(pvname: str, conn: bool, **_: Any) -> None:
        if not conn:
            say(pvname, connected=False)

    pvs = [
        epics.PV(name, form="time", callback=update, connection_callback=connection, auto_monitor=True)
        for name in NAMES
    ]
    while pvs:
        time.sleep(1)


if LIBRARY == "aioca":
    asyncio.run(with_aioca())
else:
    with_pyepics()
