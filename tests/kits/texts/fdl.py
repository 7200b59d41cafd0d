"""Cases for the rooms fdl and phy: the state table in full, texts of events, refusals, defaults, names of services."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec.structs import replace
from texts.snapshot import Case, Group, attempt

from dpstack.errors import ConfigError, UsageError
from dpstack.fdl.active.services import SERVICES
from dpstack.fdl.active.states import TABLE
from dpstack.fdl.active.station import ActiveStation
from dpstack.fdl.baud_search import AutoBaud, BaudFound, BaudNotFound, Confidence, Missing
from dpstack.fdl.codec import encode, encode_sd1, encode_sd2, encode_token
from dpstack.fdl.events import (
    AddressCollision,
    DoesNotFit,
    MasterSeen,
    RingJoined,
    RingLeft,
    StationFound,
    TokenLost,
    le3_notice,
)
from dpstack.fdl.interface import Request, Responder
from dpstack.fdl.passive.multi_station import Multidrop
from dpstack.fdl.passive.station import PassiveStation
from dpstack.fdl.service_names import request_name, service
from dpstack.fdl.telegram import SHORT_ACK, Kind, Req, Resp, StationType, Telegram, token
from dpstack.params import BusParams
from dpstack.phy.noise import BitNoise

FILE = "texts_fdl.jsonl"
_PARAMS = BusParams.preset(500_000, address=2)
_MS = 1_000_000


def _states() -> Iterator[Case]:
    for row in TABLE:
        targets = ", ".join(target.name for target in row.next)
        yield f"{row.state.name} {row.input.name}", f"{row.handler} | {targets} | {row.does} | {row.source}"


def _services() -> Iterator[Case]:
    for function, known in SERVICES.items():
        yield function.name, repr(known)
    for function in Req:
        yield f"{function.name}", request_name(Request(3, function))
    for function in (Req.SRD_HIGH, Req.FDL_STATUS, Req.CLOCK_VALUE):
        fc = 0xC0 if function is Req.CLOCK_VALUE else 0x40 | function
        yield f"{function.name}, telegram", service(Telegram(Kind.SD2, 3, 2, fc, 60, 62))
    ways = ((None, 50), (0, None), (0, 50), (48, 50), (49, 50), (48, 62), *((dsap, 62) for dsap in range(50, 64)))
    for dsap, ssap in ways:
        yield f"{dsap} to {ssap}", request_name(Request(3, Req.SRD_HIGH, dsap=dsap, ssap=ssap))
    for dsap, ssap in ((None, None), (0, 50), (60, 62)):
        yield f"answer of {dsap} to {ssap}", service(Telegram(Kind.SD2, 2, 3, Resp.DL, ssap, dsap, b"x"))
    for telegram in (SHORT_ACK, token(2, 3), Telegram(Kind.SD1, 2, 3, 0), Telegram(Kind.SD2, 2, 3, 8, None, None, b"")):
        yield repr(telegram), service(telegram)
    for kind in StationType:
        yield kind.name, kind.text


def _events() -> Iterator[Case]:
    for claimed, masters in ((False, (2,)), (True, (1, 2, 9))):
        event = RingJoined(t_ns=0, address=2, claimed=claimed, masters=masters)
        yield repr(event), event.text
    for present, before in ((False, False), (True, True)):
        event_ = MasterSeen(t_ns=0, address=7, present=present, before=before)
        yield repr(event_), event_.text
    others = [
        MasterSeen(t_ns=0, address=7, present=True),
        RingLeft(t_ns=0, address=2, reason="ordered"),
        AddressCollision(t_ns=0, address=2),
        TokenLost(t_ns=0, address=2),
        *(StationFound(t_ns=0, address=4, kind=kind) for kind in (None, *StationType)),
        le3_notice("fdl", 4, 77),
        *(DoesNotFit(t_ns=0, service="Get_Cfg", address=4, takes_ns=7 * _MS, slack_ns=ns) for ns in (0, 2 * _MS)),
        *(
            BaudFound(t_ns=0, baud=baud, listened_ns=_MS, confidence=confidence, telegrams=2, tried=3)
            for baud, confidence in zip((9_600, 1_500_000), Confidence, strict=False)
        ),
        *(
            BaudNotFound(t_ns=0, why=why, listened_ns=2_340 * _MS, octets=17, slowest=93_750, complete=complete)
            for why, complete in zip(Missing, (False, True), strict=True)
        ),
    ]
    for other in others:
        yield repr(other), other.text


class _Silent(Responder):
    def serve(self, request: Telegram, now: int) -> None:
        """No answer."""


def _refusals() -> Iterator[Case]:
    for da, sa, fc in ((128, 0, 0), (0, 127, 0), (0, 0, 256), (-1, 0, 0), (0, -1, 0), (0, 0, -1), (127, 126, 255)):
        yield attempt(encode_sd1, da, sa, fc)
        yield attempt(encode_sd2, da, sa, fc, b"x")
    yield attempt(encode_sd1, 0, 0, 0)
    for size, dsap, ssap in ((0, None, None), (246, None, None), (247, None, None), (244, 1, 2), (245, 1, 2)):
        yield attempt(encode_sd2, 3, 2, 0x4D, bytes(size), dsap, ssap)
    for dsap, ssap in ((-1, None), (64, None), (None, -1), (None, 64), (0, 63)):
        yield attempt(encode_sd2, 3, 2, 0x4D, b"x", dsap, ssap)
    for da, sa in ((-1, 0), (0, -1), (126, 127), (127, 126), (0, 126), (126, 0)):
        yield attempt(encode_token, da, sa)
    base = Telegram(Kind.SD1, 3, 2, 0x49)
    for change in ({"data": b"x"}, {"dsap": 0}, {"ssap": 0}, {"dseg": 0}, {"sseg": 0}, {}, {"kind": Kind.SD3}):
        yield attempt(encode, replace(base, **change))
    for dseg, sseg in (
        (0, 0), (63, 63), (0, None), (None, 0), (0, -1), (63, 64), (-1, None), (None, -1), (64, 0), (None, 64),
    ):  # fmt: skip
        yield attempt(encode, Telegram(Kind.SD2, 3, 2, 0x4D, 5, None, b"x", dseg, sseg))
    yield attempt(encode, token(3, 2))
    yield attempt(encode, SHORT_ACK)
    for rates in ((), (9_600, 500_000), (9_601,)):
        yield f"rates {rates}", _chosen_baud(rates)
    for address in (-1, 0, 126, 127):
        yield (
            attempt(PassiveStation, address, None, _PARAMS)
            if not 0 <= address <= 126
            else (
                f"PassiveStation {address}",
                repr(PassiveStation(address, _Silent(), _PARAMS)),
            )
        )
    for t_sdr in (10,):
        yield f"t_sdr {t_sdr}", attempt(PassiveStation, 3, None, _PARAMS, t_sdr=t_sdr)[1]
    stations = [PassiveStation(address, _Silent(), _PARAMS) for address in (3, 5)]
    line = Multidrop(stations, _PARAMS)
    absent = PassiveStation(4, _Silent(), _PARAMS)
    for call in (line.remove, line.silence, line.resume, line.silent_until):
        yield f"{call.__name__} of an absent station", attempt(call, absent)[1]
    for other in (PassiveStation(5, _Silent(), _PARAMS), PassiveStation(6, _Silent(), BusParams.preset(9_600))):
        yield f"add {other!r}", attempt(line.add, other)[1]
    for station in (stations[0], line, ActiveStation(_PARAMS, []), AutoBaud(0)):
        yield f"{type(station).__name__} order", attempt(station.command, "an order", 0)[1]
        yield f"{type(station).__name__} hears all", repr(getattr(station, "hears_all", None))
    yield "AutoBaud address", repr(AutoBaud(0).address)
    for rate in (-0.1, 1.0):
        yield f"noise {rate}", attempt(BitNoise, rate, None)[1]


def _chosen_baud(rates: tuple[int, ...]) -> str:
    try:
        return str(AutoBaud(0, rates=rates).baud)
    except (ConfigError, UsageError) as error:
        return f"{type(error).__name__}: {error}"


GROUPS: dict[str, Group] = {
    "states": _states,
    "services": _services,
    "events": _events,
    "refusals": _refusals,
}
