"""A backlog in the store of MQTT, made of values that connectors have kept, and its arrival at a subscriber."""

from __future__ import annotations

import contextlib
import os
import shutil
import sqlite3
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Final

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

from dpstack.bridge.mqtt import sparkplug_pb2 as pb

#: s of pause between two tries to connect
_AGAIN_S: Final = 0.05
#: niceness of the thread that reads
_LOW: Final = 10


class Backlog:
    """``file``: the store of an edge node that does not run. ``values``: those of the backlog."""

    def __init__(self, file: Path, values: int) -> None:
        self.values = 0
        self._file = file
        self._copy = file.with_suffix(".backlog")
        with contextlib.closing(sqlite3.connect(file, isolation_level=None)) as sql:
            while self._count(sql) < values:
                # again with the same times, behind the first ones: they are read in the order of time and id
                sql.execute(
                    "INSERT INTO entries SELECT boot, at_ms, id + (SELECT max(id) FROM entries), clock, metric, value,"
                    " reason, note FROM entries"
                )
        shutil.copyfile(file, self._copy)

    def _count(self, sql: sqlite3.Connection) -> int:
        self.values = int(sql.execute("SELECT count(*) FROM entries").fetchone()[0])
        if not self.values:
            raise RuntimeError(f"{self._file}: the connectors have kept no values; this computer may be too busy")
        return self.values

    def put_back(self) -> None:
        """All values wait again."""
        for suffix in ("-wal", "-journal"):
            Path(f"{self._file}{suffix}").unlink(missing_ok=True)
        shutil.copyfile(self._copy, self._file)


class Arrivals:
    """``historical``, ``live``: values that have arrived; ``last``: when a historical one did, by time.monotonic()."""

    def __init__(self, group: str) -> None:
        self.historical = self.live = 0
        self.last = 0.0
        self._group = group

    def _on_message(self, _client: mqtt.Client, _: object, message: mqtt.MQTTMessage) -> None:
        if "DATA" not in message.topic.split("/")[2]:
            return
        metrics = pb.Payload.FromString(bytes(message.payload)).metrics
        old = sum(metric.is_historical for metric in metrics)
        self.historical += old
        self.live += len(metrics) - old
        if old:
            self.last = time.monotonic()

    @contextlib.contextmanager
    def counting(self, port: int, seconds: float, processor: int | None = None) -> Iterator[None]:
        """Count within the block, on ``processor`` at a low priority. Raises RuntimeError where the broker at ``port``
        does not come in ``seconds``."""
        client = mqtt.Client(CallbackAPIVersion.VERSION2, client_id="bench arrivals", protocol=mqtt.MQTTv5)
        client.on_message = self._on_message

        def begin(client: mqtt.Client, *_: object) -> None:
            if processor is not None:
                # of the thread that reads
                os.sched_setaffinity(0, {processor})
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _LOW)
            client.subscribe(f"spBv1.0/{self._group}/#")

        client.on_connect = begin
        limit = time.monotonic() + seconds
        while True:
            try:
                client.connect("127.0.0.1", port)
                break
            except OSError as error:
                if time.monotonic() > limit:
                    raise RuntimeError(f"the broker does not come: {error}") from None
                time.sleep(_AGAIN_S)
        client.loop_start()
        try:
            yield
        finally:
            client.disconnect()
            client.loop_stop()
