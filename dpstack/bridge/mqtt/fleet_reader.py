"""Reads the statuses of all segments of a broker over one connection, which is made again when it is lost.

It subscribes and publishes nothing, but if the caller asks for births.
"""

from __future__ import annotations

import asyncio
import logging
import random
import secrets
import time
from collections.abc import Callable
from typing import Final

import aiomqtt

from dpstack.boottime import boottime_s
from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.connection import (
    FIRST_RETRY_S,
    LONGEST_RETRY_S,
    LastError,
    cancellations,
    close,
    connect,
    end_if_cancelled,
    is_refused,
    make_client,
    retry_s,
    session_of,
    spread,
    subscribe,
    text_of,
    why_lost,
)
from dpstack.bridge.mqtt.fleet import Fleet, Segment, rebirth_of
from dpstack.errors import UsageError
from dpstack.text import printable, shortened

#: messages that wait to be read: the retained ones come all at once
_MOST_WAITING: Final = 1000
#: s between two looks at the time
_TICK_S: Final = 0.5
#: s for the retained statuses, until all known gateways are asked for births
_LEARNING_S: Final = 2.0
#: s between two requests for births, so that not all gateways publish at once
_REBIRTH_S: Final = 0.05
ALL: Final = "all"


class FleetReader:
    """``fleet``: is kept up to date; ``changed`` is called with each segment that people should see anew, ``told`` with
    remarks about the broker. ``rebirth``: None, :data:`ALL` or (group, node): asked for births once.

    ``connected``: whether the connection stands; ``was_connected``: whether it ever did; ``lost``: messages that came
    faster than they could be read.
    """

    def __init__(
        self,
        broker: Broker,
        fleet: Fleet,
        *,
        changed: Callable[[Segment], object],
        told: Callable[[str], object],
        rebirth: str | tuple[str, str] | None = None,
        again_s: float = FIRST_RETRY_S,
    ) -> None:
        #: since the connection began
        self._accepted = False
        self.connected = self.was_connected = False
        self._lost_before = 0
        self._queue: object = None
        self._broker = broker
        self._fleet = fleet
        self._changed = changed
        self._told = told
        self._rebirth = rebirth
        self._again_s = again_s
        self._tls = broker.tls_context()
        self._error = LastError(logging.ERROR)
        self._last_told = ""

    @property
    def lost(self) -> int:
        return self._lost_before + int(getattr(self._queue, "lost", 0))

    async def run(self) -> None:
        """Read until cancelled. Raises UsageError if the broker refuses user or password at the first connection."""
        ticking = asyncio.create_task(self._tick(), name="dpstack fleet: time")
        try:
            await self._connect_again_and_again()
        finally:
            ticking.cancel()
            await asyncio.gather(ticking, return_exceptions=True)

    async def _connect_again_and_again(self) -> None:
        loop = asyncio.get_running_loop()
        failed = 0
        while True:
            began, self._error.text, self._accepted = loop.time(), "", False
            try:
                await self._session()
            except (aiomqtt.MqttError, OSError, ValueError) as error:
                why = shortened(printable(why_lost(error, self._error, connected=self._accepted)), 200)
                if is_refused(error) and not self.was_connected:
                    raise UsageError(
                        f"broker {self._broker.place}: {why}: give --user and --password-env or --password-file as the "
                        f"broker knows them"
                    ) from None
                failed = 0 if loop.time() - began > LONGEST_RETRY_S else failed + 1
                self._tell(f"broker {self._broker.place}: {why}; it is tried again")
            await asyncio.sleep(spread(retry_s(self._again_s, failed), random.random))

    def _tell(self, text: str) -> None:
        """Report a remark; one that is the same as the last one is left out."""
        if text != self._last_told:
            self._last_told = text
            self._told(text)

    async def _session(self) -> None:
        before = cancellations()
        client = make_client(
            self._broker,
            self._tls,
            self._error,
            f"dpstack-fleet-{secrets.token_hex(6)}",
            most_waiting=_MOST_WAITING,
        )
        self._queue = client._queue
        asking = None
        try:
            await connect(client)
            await subscribe(client, self._fleet.subscriptions, qos=0)
            end_if_cancelled(before)
            self.connected = self.was_connected = self._accepted = True
            self._tell(f"connected to {self._broker.place}")
            if self._rebirth is not None:
                asking = asyncio.create_task(self._ask_for_births(client), name="dpstack fleet: births")
            await self._read(client)
        finally:
            self.connected = False
            if asking is not None:
                asking.cancel()
                await asyncio.gather(asking, return_exceptions=True)
            self._lost_before, self._queue = self.lost, None
            await close(client)

    async def _read(self, client: aiomqtt.Client) -> None:
        inbox = client._queue
        async for message in client.messages:
            self._take(message)
            # each of them costs the library several turns of the loop, and one more message comes in each
            while not inbox.empty():
                self._take(inbox.get_nowait())

    def _take(self, message: aiomqtt.Message) -> None:
        payload = message.payload if isinstance(message.payload, bytes) else b""
        expiry = getattr(message.properties, "MessageExpiryInterval", None)
        segment = self._fleet.receive(
            str(message.topic),
            payload,
            boottime_s(),
            expiry=expiry,
            session=session_of(message),
            retained=bool(message.retain),
            wall=time.time(),
        )
        if segment is not None:
            self._changed(segment)

    async def _tick(self) -> None:
        """Find the segments that have become silent."""
        while True:
            await asyncio.sleep(_TICK_S)
            for segment in self._fleet.tick(boottime_s()):
                self._changed(segment)

    async def _ask_for_births(self, client: aiomqtt.Client) -> None:
        if self._rebirth == ALL:
            await asyncio.sleep(_LEARNING_S)
            asked = [(one.group, one.node) for one in self._fleet]
        else:
            assert isinstance(self._rebirth, tuple)
            asked = [self._rebirth]
        self._rebirth = None
        count = 0
        try:
            for group, node in asked:
                if count:
                    await asyncio.sleep(_REBIRTH_S)
                topic, payload = rebirth_of(group, node, round(time.time() * 1000))
                await client.publish(topic, payload)
                count += 1
        except aiomqtt.MqttError as error:
            why = shortened(printable(text_of(error)), 200)
            self._tell(f"only {count} of {len(asked)} gateways were asked for births: {why}")
        else:
            self._tell(f"asked for births: {count} gateway{'' if count == 1 else 's'}")
