"""A slave that raises alarms, and a master that knows octets only: it reads them in Slave_Diag and acknowledges."""

from __future__ import annotations

from slave_kit import CFG, MASTER, PRM, Bench, Recorder, srd

from dpstack.dp.pdu.alarm_blocks import Alarm
from dpstack.dpv1.slave.alarms import AlarmServer, AlarmSupport, Raised
from dpstack.fdl.interface import SC_REPLY, Reply
from dpstack.fdl.telegram import Kind, Resp, Telegram

KINDS = frozenset(("pull_plug", "process", "diagnostic", "manufacturer", "status", "update"))
#: DPV1_Status_2 with every kind
ALL = 0xFC


def prm(enabled: int = ALL, mode: int = 0) -> bytes:
    """Set_Prm with DPV1_Enable."""
    return PRM + bytes((0x80, enabled, mode))


class OctetMaster(Bench):
    """Requests alternate their frame count bit, as a master's do."""

    fcb = 0

    def start_with(self, parameters: bytes, config: bytes, outputs: bytes) -> None:
        """In data exchange."""
        self.prm(parameters)
        self.cfg(config)
        self.diag()
        self.outputs = outputs
        self.dx(outputs)
        self.app.take_events()

    def ask(self, dsap: int | None, data: bytes = b"", sa: int = MASTER, *, fresh: bool = False) -> Reply:
        """``fresh``: the master takes the station up afresh, as after an answer that was lost."""
        request = srd(dsap, data, sa)
        if sa == MASTER:
            self.fcb ^= 0x20
        octet = request.fc & 0x4F | (0x20 if fresh else 0x10 | self.fcb)
        request = Telegram(Kind.SD2, request.da, sa, octet, request.dsap, request.ssap, data)
        reply = self.app.serve(request, self.now)
        assert reply is not None
        return reply

    @property
    def must_fetch(self) -> bool:
        """The next Data_Exchange says so (DH)."""
        return self.dx(self.outputs).status is Resp.DH

    def ext(self, sa: int = MASTER) -> str:
        """The octets after the fixed ones of the diagnosis."""
        return self.diag(sa)[6:].hex(" ").upper()

    def fetch(self) -> str:
        """Fetch the diagnosis that the slave offers; its blocks."""
        assert self.must_fetch
        return self.ext()

    def ack(self, text: str, sap: int = 51) -> str:
        """Slot, type and specifier in hex; the answer."""
        assert self.ask(sap, bytes.fromhex("5C" + text)) == SC_REPLY
        return self.poll(sap)

    def poll(self, sap: int = 51) -> str:
        """An empty request."""
        reply = self.ask(sap)
        return reply.data.hex(" ").upper() if reply.status is Resp.DL else ""


class AlarmBench(OctetMaster):
    """With a slave that raises every kind of alarm."""

    def __init__(self, *, sequence: int = 0, extra_sap: bool = False, room: int = 238) -> None:
        device = Recorder()
        device.max_diag_len = 6 + room
        self.alarms = device.alarm_server = AlarmServer(AlarmSupport(KINDS, sequence, extra_sap), room, device.name)
        super().__init__(device)

    def start(self, octets: bytes | None = None) -> AlarmBench:
        """In data exchange, with everything enabled where no parameters are given."""
        self.start_with(prm() if octets is None else octets, CFG, b"\x55")
        return self

    def raise_(self, text: str, *, add_ack: bool = False) -> Raised:
        """Type, slot, specifier and data in hex."""
        octets = bytes.fromhex(text)
        return self.alarms.alarm(Alarm(octets[0], octets[1], octets[2], data=octets[3:], add_ack=add_ack))
