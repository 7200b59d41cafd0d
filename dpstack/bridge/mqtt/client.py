"""The connector of MQTT: a plant in Sparkplug B or plain JSON over one connection to a broker, with aiomqtt.

One task sends, one reads. A broker that is slow, stopped or gone costs neither memory nor time of others: values that
change meanwhile replace one another in the node, and each call has a limit.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import math
import random
import ssl
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Final

import aiomqtt
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from dpstack.boottime import boottime_s
from dpstack.bridge.connector import Connector, Tell
from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.connection import (
    FIRST_RETRY_S,
    MOST_WAITING,
    Inbox,
    LastError,
    cancellations,
    close,
    connect,
    end_if_cancelled,
    make_client,
    retry_s,
    spread,
    subscribe,
    why_lost,
)
from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.history import History
from dpstack.bridge.mqtt.history_keeper import HistoryKeeper
from dpstack.bridge.mqtt.plant_node import (
    Disconnect,
    NodeOptions,
    NodeSetup,
    OrderWish,
    PlantNode,
    Publish,
    Unsubscribe,
)
from dpstack.bridge.mqtt.session_file import SessionFile
from dpstack.bridge.mqtt.status import EXPIRY_S, StatusSource, topic_of
from dpstack.bridge.mqtt.worker_thread import in_thread
from dpstack.bridge.orders import Orders, time_words
from dpstack.plant.tree import Change, PlantTree
from dpstack.text import printable
from dpstack.trace import Severity

#: s for the farewell at the end of the run
_FAREWELL_S: Final = 2.0
#: s until the first try of a program, and until the births behind "online" of the primary host, at most: a plant whose
#: power comes back, and a host that does, would have all births at once
_FIRST_PAUSE_S: Final = 1.0
_BIRTHS_PAUSE_S: Final = 2.0
#: s after another client took the connection over, and the number of sessions ended early that look like it
_TAKEN_OVER_PAUSE_S: Final = 60.0
_TAKEN_OVER_AFTER: Final = 4
#: s in which this many ends of sessions look like it, too
_AGAIN_AND_AGAIN_S: Final = 600.0
#: a session that lasted this many s was a good one
_GOOD_S: Final = 30.0
#: s between two round trips by which the broker confirms what was sent; and for those at the end of the run
_ROUND_S: Final = 2.0
_LAST_ROUND_S: Final = 0.5
_LAST_WRITE_S: Final = 0.5
#: s between two remarks about messages that were lost
_LOST_REMARK_S: Final = 10.0
#: name of a thread
_DISK: Final = "dpstack mqtt: number of the session"
#: orders that wait for their result
_MOST_ORDERS: Final = 256
_TOO_MANY: Final = "too many orders wait"
#: reason code of MQTT 5 (2.4)
_TAKEN_OVER: Final = 0x8E


class MqttConnector(Connector):
    """``folder``: for the number of the session (:func:`dpstack.bridge.mqtt.broker.state_folder`). ``orders``: None:
    hosts may give no orders. ``versions``: of programs, for the status of the segment; None: none is published.
    ``store_mb``: MB for values that cannot be delivered; 0: they are lost. ``make_node``: the class for its payloads.
    ``again_s``: s until the first new try, by which all pauses scale. ``draw``: draws numbers from 0 to 1 for them."""

    name: ClassVar[str] = "mqtt"

    def __init__(
        self,
        tree: PlantTree,
        tell: Tell,
        *,
        broker: Broker,
        setup: NodeSetup,
        folder: Path,
        orders: Orders | None = None,
        versions: Mapping[str, str] | None = None,
        store_mb: int = 0,
        again_s: float = FIRST_RETRY_S,
        draw: Callable[[], float] = random.random,
        make_node: type[PlantNode] = EdgeNode,
    ) -> None:
        super().__init__(tree, tell)
        self._broker = broker
        self._setup = setup
        self._folder = folder
        self._orders = orders
        self._status = None if versions is None else StatusSource(tree, versions)
        self._again_s = again_s
        self._draw = draw
        self._make_node = make_node
        self._tls: ssl.SSLContext | None = None
        self._numbers: SessionFile | None = None
        self._node: PlantNode | None = None
        self._wake = asyncio.Event()
        self._history = History() if store_mb else None
        self._keeper: HistoryKeeper | None = None
        if self._history is not None:
            self._keeper = HistoryKeeper(self._history, folder, store_mb, tell, self._wake.set)
        self._round_wanted = asyncio.Event()
        self.connected = self._was_connected = False
        self._last_error = LastError(logging.ERROR)
        #: orders that are carried out, and their number by task
        self._giving: dict[asyncio.Task[None], int] = {}
        #: messages of the broker that were too many at once; those not reported yet, and the time of the next remark
        self._lost = self._lost_unreported = 0
        self._lost_remark_due = -math.inf

    async def open(self) -> None:
        """Read the certificates, take the folder. Raises ConfigError."""
        self._tls = await in_thread("dpstack mqtt: certificates", self._broker.tls_context)
        self._numbers = numbers = await in_thread(_DISK, SessionFile, self._folder)
        if numbers.damaged and self._make_node.counts_sessions:
            self.tell(
                f"the number of the last session in {self._folder} is damaged: one session without values comes first",
                Severity.WARNING,
            )
        self._node = self._make_node(
            self._setup,
            self.tree,
            NodeOptions(
                allowed=self._allowed,
                tell=lambda text: self.tell(text, Severity.WARNING),
                refused=self._refuse,
                clear_first=numbers.damaged,
                history=self._history,
                pause=lambda: self._pause(_BIRTHS_PAUSE_S),
            ),
        )

    def _allowed(self) -> frozenset[str]:
        return frozenset() if self._orders is None else frozenset(order.name for order in self._orders.allowed)

    def _refuse(self, name: str, reason: str, order_time: str) -> None:
        if self._orders is not None:
            self._orders.refuse(name, reason, order_time=order_time)

    def take(self, changes: Sequence[Change]) -> None:
        if self._node is not None:
            self._node.take(changes, time.time(), boottime_s())
            if self._status is not None:
                self._status.take(changes)
            self._wake.set()
            self._count_dropped()

    async def serve(self) -> None:
        keeping = None
        if self._keeper is not None:
            keeping = asyncio.create_task(self._keeper.serve(), name="dpstack mqtt: disk")
            keeping.add_done_callback(self._keeping_ended)
        try:
            await self._serve()
        finally:
            if self._keeper is not None and keeping is not None:
                await self._keep_rest(self._keeper, keeping)

    async def _serve(self) -> None:
        loop = asyncio.get_running_loop()
        failed = ended_early = 0
        #: times at which a session has ended that the broker had accepted
        ends: deque[float] = deque(maxlen=_TAKEN_OVER_AFTER)
        await asyncio.sleep(self._pause(_FIRST_PAUSE_S))
        while True:
            began, self._was_connected, self._last_error.text = loop.time(), False, ""
            try:
                end = await self._session()
            except (aiomqtt.MqttError, OSError, ValueError) as error:
                early = loop.time() - began < _GOOD_S
                failed = failed + 1 if early else 0
                ended_early = ended_early + 1 if early and self._was_connected else 0
                pause = retry_s(self._again_s, failed)
                if self._was_connected:
                    ends.append(loop.time())
                taken_over = _is_taken_over(error)
                if taken_over or ended_early >= _TAKEN_OVER_AFTER:
                    pause = _TAKEN_OVER_PAUSE_S * self._again_s
                # not every broker says that a connection was taken over; two gateways that wait have long sessions
                if taken_over or (len(ends) == ends.maxlen and ends[-1] - ends[0] < _AGAIN_AND_AGAIN_S):
                    does = (
                        "has given the connection to another client"
                        if taken_over
                        else "closes the connection again and again"
                    )
                    probably = "" if taken_over else "probably "
                    self.tell(
                        f"broker {self._broker.place} {does}: {probably}another gateway uses this node's name (group "
                        f"{self._setup.group!r}, node {self._setup.node!r}); give one of them another node",
                        Severity.ERROR,
                    )
                else:
                    why = why_lost(error, self._last_error, connected=self._was_connected)
                    self.tell(f"broker {self._broker.place}: {printable(why)}; it is tried again", Severity.WARNING)
            else:
                failed, ended_early, pause = 0, 0, self._again_s
                self.tell(f"the session has ended: {end.why}", Severity.INFO)
            await asyncio.sleep(spread(pause, self._draw))

    def _pause(self, most_s: float) -> float:
        """s, from 0 to ``most_s``."""
        return most_s * self._again_s / FIRST_RETRY_S * self._draw()

    def close(self) -> None:
        for task in self._giving:
            task.cancel()
        if self._keeper is not None:
            self._keeper.close()
        if self._numbers is not None:
            self._numbers.close()

    # --- a session ------------------------------------------------------------------------------------------------

    async def _session(self) -> Disconnect:
        """One connection from its begin to its end. Returns if the edge node ends it; raises MqttError, OSError."""
        node, numbers = self._node, self._numbers
        assert node is not None
        assert numbers is not None, "open() comes first"
        before = cancellations()
        try:
            number = await in_thread(_DISK, numbers.next)
        except OSError as error:
            raise OSError(f"the number of the session cannot be written in {self._folder}: {error.strerror}") from None
        connection = node.connect(number, time.time())
        client = make_client(
            self._broker,
            self._tls,
            self._last_error,
            connection.client_id,
            most_waiting=MOST_WAITING + connection.most_kept,
            will=connection.will,
        )
        try:
            await connect(client)
            await subscribe(client, connection.subscriptions, qos=1)
            end_if_cancelled(before)
            node.connected()
            if self._status is not None:
                self._status.begin(number)
            self.connected = self._was_connected = True
            self.tell(f"connected to {self._broker.place}", Severity.INFO)
            return await self._exchange(node, client)
        finally:
            self.connected = False
            node.disconnected()
            self._count_lost(client, is_end=True)
            await close(client)

    async def _exchange(self, node: PlantNode, client: aiomqtt.Client) -> Disconnect:
        sending = asyncio.create_task(self._send(node, client), name="dpstack mqtt: sending")
        reading = asyncio.create_task(self._read(node, client), name="dpstack mqtt: reading")
        confirming = asyncio.create_task(self._confirm(client), name="dpstack mqtt: confirming")
        tasks = (sending, reading, confirming)
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        except asyncio.CancelledError:
            for task in (sending, confirming):
                task.cancel()
            await asyncio.wait((sending, confirming))
            await self._say_farewell(node, client)
            raise
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
        for task in (reading, confirming):
            if not task.cancelled() and (error := task.exception()) is not None:
                raise error  # the first one knows why the connection has ended
        return sending.result()

    async def _send(self, node: PlantNode, client: aiomqtt.Client) -> Disconnect:
        loop = asyncio.get_running_loop()
        before = cancellations()
        while True:
            status = None if self._status is None else self._status.next(loop.time(), time.time())
            if status is not None:
                await self._publish_status(client, status)
                end_if_cancelled(before)
            message = node.next(time.time(), boottime_s())
            if isinstance(message, Disconnect):
                return message
            if message is not None:
                if isinstance(message, Unsubscribe):
                    await client.unsubscribe(message.topic)
                else:
                    await _publish(client, message)
                end_if_cancelled(before)
                await asyncio.sleep(0)  # births of many slaves: others have their turn between
                continue
            self._wake.clear()
            self._look_after_history()
            wait_s = node.due(boottime_s()) - boottime_s()
            if self._status is not None:
                wait_s = min(wait_s, self._status.due(loop.time()) - loop.time())
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout_at(loop.time() + min(wait_s, 3600)):
                    await self._wake.wait()

    async def _publish_status(self, client: aiomqtt.Client, payload: bytes) -> None:
        topic = topic_of(self._setup.group, self._setup.node)
        await _publish(client, Publish(topic, payload, retain=True, expiry_s=EXPIRY_S))

    async def _read(self, node: PlantNode, client: aiomqtt.Client) -> None:
        async for message in client.messages:
            payload = message.payload if isinstance(message.payload, bytes) else b""
            wishes = node.receive(str(message.topic), payload, time.time(), retained=message.retain)
            self._give_all(node, wishes)
            self._count_lost(client)
            self._wake.set()

    async def _say_farewell(self, node: PlantNode, client: aiomqtt.Client) -> None:
        with contextlib.suppress(TimeoutError, aiomqtt.MqttError, OSError):
            async with asyncio.timeout(_LAST_ROUND_S):
                await self._round_trip(client)
        node.end("the run has ended")
        with contextlib.suppress(TimeoutError, aiomqtt.MqttError, OSError):
            async with asyncio.timeout(_FAREWELL_S):
                status, self._status = self._status, None
                if status is not None:
                    await self._publish_status(client, status.last(time.time()))
                await self._send(node, client)

    # --- history --------------------------------------------------------------------------------------------------

    def _look_after_history(self) -> None:
        """Nothing is to be sent at this moment: the disk and the next round trip may have to begin."""
        if self._history is not None and self._keeper is not None:
            if self._history.needs_disk:
                self._keeper.wake()
            if self._history.is_chunk_sent:
                self._round_wanted.set()

    async def _confirm(self, client: aiomqtt.Client) -> None:
        """Confirm what was sent by round trips on this connection. Raises MqttError if the broker does not answer:
        then nobody knows what it has read."""
        before = cancellations()
        while True:
            self._round_wanted.clear()
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_ROUND_S):
                    await self._round_wanted.wait()
            await self._round_trip(client)
            end_if_cancelled(before)

    async def _round_trip(self, client: aiomqtt.Client) -> None:
        history, keeper = self._history, self._keeper
        if history is None or keeper is None or not history.is_unconfirmed:
            return
        number = history.begin_round()
        # nobody has subscribed it; the broker answers in the order of what it reads
        await client.unsubscribe(f"{self._setup.topic('NCMD')}/round-trip")
        history.confirm(number)
        keeper.wake()

    async def _keep_rest(self, keeper: HistoryKeeper, keeping: asyncio.Task[None]) -> None:
        """At the end of the run: what was not delivered goes to the disk."""
        if keeping.done():
            return  # it has ended by a fault, and reported it
        keeping.cancel()
        await asyncio.gather(keeping, return_exceptions=True)
        await keeper.finish(_LAST_WRITE_S)

    def _keeping_ended(self, task: asyncio.Task[None]) -> None:
        if not task.cancelled() and (error := task.exception()) is not None:
            text = (
                f"values that cannot be delivered are not kept on the disk any more ({type(error).__name__}: {error})"
            )
            self.tell(text, Severity.ERROR)

    # --- orders ---------------------------------------------------------------------------------------------------

    def _give_all(self, node: PlantNode, wishes: Sequence[OrderWish]) -> None:
        """Give the orders of one message, which are all to one slave. Its outputs change together."""
        if not wishes:
            return
        assert self._orders is not None, "without orders no metric can be written"
        outputs: list[OrderWish] = []
        for wish in wishes:
            if self._orders.sets_output(wish.name):
                outputs.append(wish)
            else:
                self._give(node, [wish])
        if outputs:
            self._give(node, outputs)

    def _give(self, node: PlantNode, wishes: Sequence[OrderWish]) -> None:
        if sum(self._giving.values()) + len(wishes) > _MOST_ORDERS:
            for wish in wishes:
                self._refuse(wish.name, _TOO_MANY, wish.order_time or time_words(wish.made_at))
                node.answer(wish, "refused", _TOO_MANY, time.time())
            return
        task = asyncio.create_task(self._carry_out(node, wishes), name=f"dpstack mqtt: {wishes[0].name}")
        self._giving[task] = len(wishes)
        task.add_done_callback(self._giving.pop)

    async def _carry_out(self, node: PlantNode, wishes: Sequence[OrderWish]) -> None:
        assert self._orders is not None
        first = wishes[0]
        if len(wishes) > 1:
            given = [(wish.name, wish.value) for wish in wishes]
            results = await self._orders.give_outputs(given, made_at=first.made_at, order_time=first.order_time)
        else:
            order_time = first.order_time
            results = [await self._orders.give(first.name, first.value, made_at=first.made_at, order_time=order_time)]
        # the last answer is the one that people see: a refused one, if there is any
        answers = sorted(zip(wishes, results, strict=True), key=lambda answer: answer[1].result != "done")
        for wish, result in answers:
            node.answer(wish, result.result, result.reason, time.time())
        self._wake.set()

    def _count_lost(self, client: aiomqtt.Client, *, is_end: bool = False) -> None:
        """Count the messages for which there was no room, and report them, not too often; ``is_end``: now."""
        inbox = client._queue
        assert isinstance(inbox, Inbox)
        lost, inbox.lost = inbox.lost, 0
        self._lost += lost
        self._lost_unreported += lost
        self._count_dropped()
        now = asyncio.get_running_loop().time()
        if not self._lost_unreported or (now < self._lost_remark_due and not is_end):
            return
        text = f"{self._lost_unreported} messages of the broker came faster than they could be read: they are lost"
        self._lost_unreported, self._lost_remark_due = 0, now + _LOST_REMARK_S
        self.tell(text, Severity.WARNING)

    def _count_dropped(self) -> None:
        self.dropped = self._lost
        self.dropped += 0 if self._node is None else self._node.lost_results
        self.dropped += 0 if self._history is None else self._history.dropped


async def _publish(client: aiomqtt.Client, message: Publish) -> None:
    properties = None
    if message.expiry_s:
        properties = Properties(PacketTypes.PUBLISH)  # type: ignore[no-untyped-call]
        properties.MessageExpiryInterval = message.expiry_s
    await client.publish(message.topic, message.payload, qos=message.qos, retain=message.retain, properties=properties)


def _is_taken_over(error: BaseException) -> bool:
    cause: BaseException | None = error
    while cause is not None:
        code = getattr(cause, "rc", None)
        if isinstance(code, ReasonCode) and code.value == _TAKEN_OVER:
            return True
        cause = cause.__cause__
    return False
