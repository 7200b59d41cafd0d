"""The blocks of alarms and status messages: what was read is built into the same octets, and its texts are plain."""

from __future__ import annotations

import json

from dpstack.dp.pdu.alarm_blocks import Alarm, Status, kind_of, message_dict, module_status, parse_block
from dpstack.dp.pdu.dpv1_status import ALARMS
from dpstack.dpv1.pdu.read_write import AlarmAck
from dpstack.errors import PduError
from tests.fuzz.frame import Target, assert_plain, parsed


def run(octets: bytes) -> None:
    """The octets are those of one block."""
    found = parsed(parse_block, octets, PduError)
    if found is None:
        return
    assert found.build() == octets
    for text in (found.title, found.text, found.full_text):
        assert_plain(text)
    assert json.loads(json.dumps(message_dict(found)))["slot"] == found.slot
    if isinstance(found, Alarm):
        assert kind_of(found.type) in ALARMS
        ack = AlarmAck.of(found)
        assert AlarmAck.parse(ack.build()) == ack
    elif found.modules:
        assert module_status(found.modules).data == found.data
    elif found.redundancy is not None:
        assert found.redundancy.octets[:3] == found.data[:3]
    assert isinstance(found, (Alarm, Status))


def repair(octets: bytes) -> bytes:
    """Give the block its length."""
    return bytes((len(octets),)) + octets[1:] if 4 <= len(octets) < 64 else octets


TARGET = Target(run, covers=("dpstack.dp.pdu.alarm_blocks", "dpstack.dpv1.pdu.read_write"), max_len=66, repair=repair)
