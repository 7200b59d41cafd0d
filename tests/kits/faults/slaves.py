"""Slaves that misbehave, for tests of masters: each a SlaveApp to build a station around."""

from __future__ import annotations

from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave.application import SlaveApp
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.loopback_device import MirrorDevice
from dpstack.fdl.interface import SC_REPLY, Reply
from dpstack.fdl.telegram import SAP_CHK_CFG, SAP_SET_PRM, Kind, Req, Telegram


def wrong_ident(device: Device, ident: int = 0xDEAD) -> SlaveApp:
    """Another device at the address."""
    device.ident = ident
    return SlaveApp(device)


def refuses_config(ident: int, real: bytes) -> SlaveApp:
    """Its real configuration is ``real``, whatever it is sent."""
    return SlaveApp(MirrorDevice(ident, real))


class RefusesParameters(MirrorDevice):
    """Accepts no user parameters at all."""

    def check_prm(self, user_prm: bytes) -> str | None:
        return f"no user parameters known ({len(user_prm)} octets came)" if user_prm else None


class WrongLength(SlaveApp):
    """Accepts its configuration, then answers Data_Exchange with ``extra`` octets more (negative: fewer)."""

    __slots__ = ("_extra",)

    def __init__(self, device: Device, extra: int = 1) -> None:
        super().__init__(device)
        self._extra = extra

    def serve(self, request: Telegram, now: int) -> Reply | None:
        reply = super().serve(request, now)
        if request.dsap is None and reply is not None and reply.data:
            length = max(1, len(reply.data) + self._extra)
            reply = reply._replace(data=reply.data[:length].ljust(length, b"\0"))
        return reply


class Dies(SlaveApp):
    """Falls silent after ``exchanges`` exchanges; :meth:`revive` switches it on again."""

    __slots__ = ("_left",)

    def __init__(self, device: Device, exchanges: int) -> None:
        super().__init__(device)
        self._left = exchanges

    def serve(self, request: Telegram, now: int) -> Reply | None:
        if request.dsap is None:
            self._left -= 1
        return super().serve(request, now) if self._left >= 0 else None

    def revive(self, now: int) -> None:
        """On again, with lasting health. It must not know FCBs of before either: use a new station, or FCV = 0."""
        self._left = 1 << 62
        self.restart(now)


class NeverReady(SlaveApp):
    """Accepts everything; Station_Not_Ready stays."""

    __slots__ = ()

    def serve(self, request: Telegram, now: int) -> Reply | None:
        if request.dsap == SAP_CHK_CFG:
            return SC_REPLY  # and nothing else
        return super().serve(request, now)


class SilentRefusal(SlaveApp):
    """Does not answer a Set_Prm or Chk_Cfg that it refuses (docs/reference/protocol.md#refusal-without-answer)."""

    __slots__ = ()

    def serve(self, request: Telegram, now: int) -> Reply | None:
        refused = self.stats.refused
        reply = super().serve(request, now)
        return None if request.dsap in (SAP_SET_PRM, SAP_CHK_CFG) and self.stats.refused > refused else reply


def locked_by(device: Device, master: int, now: int = 0) -> SlaveApp:
    """In the hands of another master (without watchdog: for good)."""
    app = SlaveApp(device)
    for sap, data in ((SAP_SET_PRM, SetPrm(device.ident).build()), (SAP_CHK_CFG, device.configs[0])):
        app.serve(Telegram(Kind.SD2, 0, master, 0x40 | Req.SRD_HIGH, sap, 62, data), now)
    return app
