"""The benchmark of a fleet of gateways without network and processes: recording, replay, judge, report."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import ClassVar

import pytest
from far_ends import beside
from sparkplug_host import tag

from bench.plant.fleet import followed, parts
from bench.plant.judge import Message, judge
from bench.plant.stream import GROUP, Recording, record, replay
from bench.report import Report
from dpstack import run_virtual
from dpstack.bridge.connector import Connector
from dpstack.bridge.gateway import Gateway
from dpstack.bridge.mqtt.edge_node import EdgeNode
from dpstack.bridge.mqtt.plant_node import NodeOptions, NodeSetup, Publish
from dpstack.plant.tree import Change, PlantTree

NODE = "gateway-07"
SECONDS = 5.0


class Collecting(Connector):
    """An edge node without a connection: ``messages`` with the virtual time."""

    name: ClassVar[str] = "collecting"

    def __init__(self, tree: PlantTree) -> None:
        super().__init__(tree, lambda *_: None)
        self.messages: list[Message] = []
        self._node = EdgeNode(NodeSetup(GROUP, NODE), tree, NodeOptions())
        self._will = self._node.connect(7, 0.0).will
        self._node.connected()

    def take(self, changes: Sequence[Change]) -> None:
        self._node.take(changes, self._now, self._now)
        self._send()

    @property
    def _now(self) -> float:
        return asyncio.get_running_loop().time()

    def _send(self) -> None:
        while isinstance(message := self._node.next(1e9 + self._now, self._now), Publish):
            self._note(message)

    def _note(self, message: Publish) -> None:
        self.messages.append(Message(round(self._now * 1e9), 1, message.topic, message.payload, message.qos))

    async def serve(self) -> None:
        try:
            while True:
                await asyncio.sleep(0.1)
                self._send()
        finally:
            self._note(self._will)


async def replayed(recording: Recording, seconds: float) -> tuple[list[Message], list[tuple[str, str, int]]]:
    """Messages of a gateway fed by a recording, and when it declared slaves lost."""
    lost: list[tuple[str, str, int]] = []
    loop = asyncio.get_running_loop()
    tree = PlantTree()
    connector = Collecting(tree)
    items = replay(recording, 1.0, lambda address: lost.append((NODE, f"s{address}", round(loop.time() * 1e9))))
    # the clock of the computer goes as fast as the virtual time
    begun = time.time() - loop.time()
    gateway = Gateway(items, [connector], tree=tree, tell=lambda *_: None, now=lambda: begun + loop.time())
    async with beside(gateway.run()):
        await asyncio.sleep(seconds)
    return connector.messages, lost


@pytest.fixture(scope="module")
def recorded() -> Recording:
    return record(2, SECONDS, 1)


def test_a_recorded_stream_goes_on_behind_its_end_and_a_host_finds_no_breach(recorded: Recording) -> None:
    messages, lost = run_virtual(replayed(recorded, 2.5 * SECONDS))
    begin = messages[0].at
    verdict = judge(messages, GROUP, {"all": (0, 1 << 62), "first": (begin, begin + 1_000_000_000)})
    assert (verdict.breaches, verdict.faults, verdict.unpaired) == (0, [], 0)
    assert len(lost) == 3  # once a turn: s3 without power for 2 s
    deaths = [death for death in verdict.deaths if death[1]]
    assert [name for _, name, _ in deaths] == ["s3"] * 3
    assert followed(lost, deaths, 10.0) == [0.0] * 3  # nothing waits in virtual time
    assert verdict.deaths[-1][:2] == (NODE, "")
    assert [name for _, name, _ in verdict.births][:3] == ["", "s3", "s4"]
    found = verdict.windows["all"]
    assert sum(number for number, _ in found.values()) == len(messages)
    # at most one message a second of each device; one is lost for a part of the time
    assert 2.5 * SECONDS < found["DDATA"][0] < 2 * 2.5 * SECONDS
    assert verdict.metrics["all"] > found["DDATA"][0]
    assert verdict.windows["first"]["NBIRTH"][0] == 1
    assert verdict.peaks["first"] == sum(number for number, _ in verdict.windows["first"].values())


def test_the_judge_finds_a_lost_message_and_a_will_of_another_session(recorded: Recording) -> None:
    messages, _ = run_virtual(replayed(recorded, 3.0))
    at = next(place for place, message in enumerate(messages) if message.kind == "DDATA")
    verdict = judge([*messages[:at], *messages[at + 1 :]], GROUP, {})
    # the host leaves the node alone until its next birth
    assert verdict.breaches == 1
    assert "of gateway-07" in verdict.faults[0]
    other = messages[-1]._replace(payload=tag(1, 1) + tag(2, tag(1, b"bdSeq") + tag(3, 1) + tag(4, 4) + tag(11, 6)))
    assert judge([*messages, other], GROUP, {}).unpaired == 1
    # data without a birth in a new connection of the subscriber are no breach: a host asks for births
    again = [message._replace(session=message.session + (n > 5)) for n, message in enumerate(messages)]
    verdict = judge(again, GROUP, {})
    assert (verdict.breaches, verdict.unjudged) == (0, len(messages) - 7)  # the will is judged


def test_octets_of_a_message_are_those_of_its_packet() -> None:
    # fixed header 2, length of the topic 2, topic 5, no properties 1, payload; QoS 1 has an identifier
    assert Message(0, 0, "a/b/c", bytes(10), 0).octets == 2 + 2 + 5 + 1 + 10
    assert Message(0, 0, "a/b/c", bytes(200), 1).octets == 3 + 2 + 5 + 2 + 1 + 200
    assert Message(0, 0, "dpstack/bench/x/status", b"", 0).kind == "status"


def test_gateways_are_shared_out() -> None:
    assert list(parts(2, 50, 4)) == [(2, 12), (14, 12), (26, 12), (38, 12)]
    assert list(parts(2, 2, 1)) == []


def test_a_death_belongs_to_the_begin_before_it() -> None:
    deaths = [("a", "s3", 50), ("a", "s3", 7_000_000_000), ("a", "s4", 90)]
    assert followed([("a", "s3", 20), ("a", "s4", 100), ("a", "s3", 60)], deaths, 1.0) == [3e-08]


def test_a_report_as_markdown_is_a_table() -> None:
    report = Report("fleet", notes=["a note"])
    report.add("messages", 12.345, "1/s")
    lines = report.finished().as_markdown().splitlines()
    assert lines[1:] == ["", "| figure | value | unit |", "|---|---|---|", "| messages | 12.35 | 1/s |", "", "a note"]
