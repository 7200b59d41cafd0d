"""Data exchange broadcast at a slave: publisher, and subscriber with its links.

A link is good while valid broadcasts of its publisher come within the watchdog time. The outputs that it gives are the
safe ones before the master has said Operate and before the first valid broadcast, after a broadcast of another length,
and once none came for the watchdog time; each change is an event and a link status message. Decisions:
docs/reference/decisions/dxb.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Final, NamedTuple

from msgspec import Struct

from dpstack.dp.pdu.alarm_blocks import Status, StatusType
from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE, PRM_STRUCTURE, PUBLISHER_ENABLE
from dpstack.dp.pdu.dxb import MAX_LINKS, Link, LinkState, link_problem, links_of
from dpstack.dp.pdu.prm_blocks import parse_blocks
from dpstack.dp.pdu.requests import SetPrm
from dpstack.dp.slave.device import DpV0Device
from dpstack.dp.slave.events import Report, SlaveAppEvent
from dpstack.dp.slave.extension import BroadcastService
from dpstack.dp.slave.prm_cfg_check import watchdog_time
from dpstack.errors import AlarmError, ConfigError, PduError
from dpstack.fdl.telegram import FC_FUNCTION, MAX_DATA, Resp, Telegram
from dpstack.gsd.identifiers import io_lengths, parse_identifiers
from dpstack.params import DPV1_STATUS_LEN
from dpstack.text import octets_text
from dpstack.units import NEVER, NS_PER_MS, ms_text

if TYPE_CHECKING:
    from dpstack.dp.slave.state import SlaveCore
    from dpstack.dpv1.slave.alarms import AlarmServer

#: octet of DPV1_Status with the bit Prm_Structure
_STATUS_3: Final = 2
#: changes of links within this time are one link status message
_TOGETHER_NS: Final = NS_PER_MS
_DATA: Final = frozenset((int(Resp.DL), int(Resp.DH)))


class DxbSupport(Struct, frozen=True):
    """Data exchange broadcast of a slave. Raises ConfigError.

    ``publisher`` [Publisher_supp]; ``links``: 0..29 that it can subscribe to [DXB_Max_Link_Count], 0: it is no
    subscriber; ``octets``: most octets of all links together [DXB_Max_Data_Length]. ``first_slot`` [Modul_Offset].
    """

    publisher: bool = False
    links: int = 0
    octets: int = MAX_DATA
    first_slot: int = 1

    def __post_init__(self) -> None:
        if not 0 <= self.links <= MAX_LINKS:
            raise ConfigError(f"{self.links} links of a subscriber: 0..{MAX_LINKS}")


class SlaveLink(Struct, frozen=True):
    """One link of a subscriber at this moment."""

    #: address of the publisher
    publisher: int
    #: octets that the publisher has by the filter
    publisher_length: int
    #: first octet that is taken, from 0
    offset: int
    #: octets that are taken
    length: int
    #: first octet of the outputs that they act as; None: they act as none
    to: int | None = None
    #: valid broadcasts come
    good: bool = False
    #: the last broadcast had another length than the filter says
    wrong_length: bool = False
    #: the octets of the last valid broadcast; empty before the first one
    data: bytes = b""


class LinkChanged(SlaveAppEvent):
    """The links to ``publisher`` have become good, or they are lost: the outputs that they give are safe."""

    #: address of the publisher
    publisher: int
    #: valid broadcasts come
    good: bool
    #: why, for people
    reason: str

    def _text(self) -> str:
        if self.good:
            return f"{self.who}: data of publisher {self.publisher} come"
        return f"{self.who}: publisher {self.publisher} is lost, its octets are safe: {self.reason}"


class _Place(NamedTuple):
    link: Link
    to: int | None  # first octet of the outputs


class _Publisher:
    """One publisher. ``until``: the end of the time in which its next valid broadcast has to come, in ns."""

    def __init__(self, length: int, until: int) -> None:
        self.length = length
        self.until = until
        self.good = self.wrong = self.reported = False
        self.data = b""


class DxbServer(BroadcastService):
    """Publisher and subscriber of one slave application. ``messages``: sends its link status messages."""

    def __init__(
        self, device: DpV0Device, support: DxbSupport, report: Report, alarms: AlarmServer | None = None
    ) -> None:
        self._device = device
        self._support = support
        self._report = report
        self._alarms = alarms
        self.can_publish = support.publisher
        self.can_subscribe = support.links > 0
        self._links: tuple[Link, ...] = ()
        self._watchdog_ns = 0
        self._places: tuple[_Place, ...] = ()
        self._publishers: dict[int, _Publisher] = {}
        self._safe = b""
        self._send_at = NEVER  # the link status message is due

    # --- Set_Prm and Chk_Cfg ------------------------------------------------------------------------------------

    def refuse_prm(self, prm: SetPrm) -> str | None:
        """Publisher_Enable and the filter, by what this slave can."""
        user = prm.user_prm
        if _publishes(user) and not self._support.publisher:
            return "Publisher_Enable is set, this device does not publish"
        try:
            links = _links(user)
        except PduError as error:
            return str(error)
        if not links:
            return None
        limit, octets = self._support.links, sum(link.length for link in links)
        if not limit:
            return "a filter of data exchange broadcast, this device is no subscriber"
        if len(links) > limit:
            return f"a filter with {len(links)} links, this device has memory for {limit}"
        if octets > self._support.octets:
            return f"a filter with {octets_text(octets)}, this device has memory for {self._support.octets}"
        if any(link.publisher == self._report.address for link in links):
            return f"a filter with publisher {self._report.address}, which is this device itself"
        if not watchdog_time(self._device, prm):
            return "a filter of data exchange broadcast without WD_On: the watchdog time is its monitoring time"
        problem = link_problem(links)
        return None if problem is None else f"filter: {problem}"

    def parameterised(self, prm: SetPrm) -> None:
        self.publishes = _publishes(prm.user_prm)
        self._links = _links(prm.user_prm) if self.can_subscribe else ()
        self._watchdog_ns = watchdog_time(self._device, prm)

    def refuse_cfg(self, config: bytes) -> str | None:
        """The places of the links, by the identifier octets."""
        if self.publishes and not io_lengths(config)[0]:
            return "Publisher_Enable is set, and this configuration has no inputs to publish"
        try:
            tuple(self._placed(config))
        except ConfigError as error:
            return str(error)
        return None

    def _placed(self, config: bytes) -> Iterator[_Place]:
        starts, total = _slots(config, self._support.first_slot)
        for number, link in enumerate(self._links, 1):
            if link.to is None:
                yield _Place(link, None)
                continue
            start, size = (0, total) if link.slot is None else starts.get(link.slot, (0, 0))
            if link.to + link.length > size:
                of = "the configuration" if link.slot is None else f"slot {link.slot}"
                last = link.to + link.length - 1
                raise ConfigError(
                    f"link {number} gives output octets {link.to}..{last} of {of}, which has {octets_text(size)}"
                )
            yield _Place(link, start + link.to)

    # --- data exchange ------------------------------------------------------------------------------------------

    def begin(self, config: bytes, now: int) -> Callable[[bytes, bool], bytes] | None:
        self.left()
        self._places = tuple(self._placed(config))
        self._safe = self._device.safe or bytes(io_lengths(config)[1])
        until = now + self._watchdog_ns
        self._publishers = {link.publisher: _Publisher(link.publisher_length, until) for link in self._links}
        self.at = until if self._publishers else NEVER
        return self._overlay if any(place.to is not None for place in self._places) else None

    def left(self) -> None:
        """No broadcast counts any more."""
        for publisher in self._publishers.values():
            publisher.good = False
        self._publishers = {}
        self.stale = False
        self.at = self._send_at = NEVER

    def _overlay(self, outputs: bytes, live: bool) -> bytes:
        octets = bytearray(outputs)
        for link, to in self._places:
            if to is None:
                continue
            publisher = self._publishers[link.publisher]
            if live and publisher.good:
                octets[to : to + link.length] = publisher.data[link.offset : link.offset + link.length]
            else:
                octets[to : to + link.length] = self._safe[to : to + link.length]
        return bytes(octets)

    def hear(self, telegram: Telegram, now: int) -> None:
        """The answer of a publisher: its data, if they have the length of the filter."""
        publisher = self._publishers.get(telegram.sa)
        if publisher is None or telegram.fc & FC_FUNCTION not in _DATA:
            return
        if telegram.dsap is not None or telegram.ssap is not None:
            return
        data = telegram.data
        if len(data) != publisher.length:
            publisher.wrong = True
            reason = f"its broadcast has {octets_text(len(data))}, the filter says {publisher.length}"
            self._lose(telegram.sa, publisher, reason, now)
            return
        publisher.until = now + self._watchdog_ns
        self.stale |= data != publisher.data or not publisher.good
        publisher.data = data
        if not publisher.good:
            publisher.good = publisher.reported = True
            publisher.wrong = False
            self._changed(telegram.sa, publisher, "", now)

    def tick(self, now: int) -> None:
        """The monitoring time of publishers, and the link status message."""
        for address, publisher in self._publishers.items():
            if publisher.until <= now:
                publisher.until = now + self._watchdog_ns
                self._lose(address, publisher, f"no valid broadcast for {ms_text(self._watchdog_ns)}", now)
        if self._send_at <= now:
            self._send(now)
        self.at = min((one.until for one in self._publishers.values()), default=NEVER)
        self.at = min(self.at, self._send_at)

    def _lose(self, address: int, publisher: _Publisher, reason: str, now: int) -> None:
        if publisher.good or not publisher.reported:
            self.stale |= publisher.good
            publisher.good = False
            publisher.reported = True
            self._changed(address, publisher, reason, now)

    def _changed(self, address: int, publisher: _Publisher, reason: str, now: int) -> None:
        self._report.emit(LinkChanged, now, publisher=address, good=publisher.good, reason=reason)
        if self._alarms is not None:
            self._send_at = min(self._send_at, now + _TOGETHER_NS)
            self.at = min(self.at, self._send_at)

    def _send(self, now: int) -> None:
        self._send_at = NEVER
        if self._alarms is None:
            return
        try:
            self._alarms.status(Status(StatusType.DXB_LINK, 0, data=b"".join(one.octets for one in self._states())))
        except AlarmError:  # too many wait: its master does not fetch them
            self._send_at = now + self._watchdog_ns

    def _states(self) -> Iterator[LinkState]:
        for link in self._links:
            one = self._publishers[link.publisher]
            yield LinkState(link.publisher, one.good, one.wrong, one.good)

    # --- for people ---------------------------------------------------------------------------------------------

    @property
    def links(self) -> tuple[SlaveLink, ...]:
        """Its links in data exchange, as they stand now."""
        return tuple(self._shown(place) for place in self._places if place.link.publisher in self._publishers)

    def _shown(self, place: _Place) -> SlaveLink:
        link, publisher = place.link, self._publishers[place.link.publisher]
        return SlaveLink(
            publisher=link.publisher,
            publisher_length=link.publisher_length,
            offset=link.offset,
            length=link.length,
            to=place.to,
            good=publisher.good,
            wrong_length=publisher.wrong,
            data=publisher.data[link.offset : link.offset + link.length],
        )


def _publishes(user_prm: bytes) -> bool:
    return bool(user_prm) and user_prm[0] & (DPV1_ENABLE | PUBLISHER_ENABLE) == DPV1_ENABLE | PUBLISHER_ENABLE


def _links(user_prm: bytes) -> tuple[Link, ...]:
    """The links in the structured parameters. Raises PduError."""
    status = user_prm[:DPV1_STATUS_LEN].ljust(DPV1_STATUS_LEN, b"\0")
    if not (status[0] & DPV1_ENABLE and status[_STATUS_3] & PRM_STRUCTURE):
        return ()
    return links_of(parse_blocks(user_prm[DPV1_STATUS_LEN:], DPV1_STATUS_LEN + 1))


def _slots(config: bytes, first_slot: int) -> tuple[dict[int, tuple[int, int]], int]:
    """By slot its first octet in the outputs and how many it has; then the octets of all outputs. Slot 0 of a device
    whose modules begin with 1 is all outputs."""
    slots: dict[int, tuple[int, int]] = {}
    at = 0
    for slot, one in enumerate(parse_identifiers(config), first_slot):
        slots[slot] = (at, one.outputs)
        at += one.outputs
    slots.setdefault(0, (0, at))
    return slots, at


def links_of_slave(core: SlaveCore) -> tuple[SlaveLink, ...]:
    """The links of a slave application; empty if it subscribes none."""
    return core.broadcast.links if isinstance(core.broadcast, DxbServer) else ()
