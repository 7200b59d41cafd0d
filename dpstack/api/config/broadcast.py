"""The links between the slaves of a configuration (data exchange broadcast): publishers, filters, and their checks.

The publisher gets Publisher_Enable and is asked by MSRD, the subscriber gets a filter in Set_Prm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Final

from msgspec import structs

from dpstack.api.config.slave import SlaveConfig
from dpstack.api.config.subscribes import Subscription
from dpstack.dp.pdu.dxb import MAX_LINKS, Link, link_problem
from dpstack.errors import ConfigError
from dpstack.gsd.model import Device
from dpstack.text import did_you_mean, octets_text

#: GSD_Revision with Publisher_supp and Subscriber_supp
_DXB_REVISION: Final = 5
#: value of the key ``filter_block`` for the block of SINAMICS
SINAMICS: Final = "sinamics"
_DPV1: Final = "add dpv1 = true (its user parameters begin with the three DPV1_Status octets)"
_OTHER: Final = "take the subscription out, or ask its maker for another GSD file"


class UnlinkedError(Exception):
    """A subscription that cannot be, of the slave with this ``number``; ``what`` and ``todo`` are for people."""

    def __init__(self, number: int, what: str, todo: str) -> None:
        super().__init__(what)
        self.number, self.what, self.todo = number, what, todo


def linked(slaves: Sequence[SlaveConfig]) -> tuple[SlaveConfig, ...]:
    """``slaves`` with the links that their subscriptions make. Raises :class:`UnlinkedError`."""
    if not any(slave.subscribes for slave in slaves):
        return tuple(slaves)
    links = [tuple(_links(number, slaves)) for number in range(len(slaves))]
    publishers = {link.publisher for row in links for link in row}
    return tuple(
        _with_links(number, slave, links[number], publishes=slave.address in publishers)
        for number, slave in enumerate(slaves)
    )


def joining(new: SlaveConfig, running: Sequence[SlaveConfig]) -> tuple[SlaveConfig, tuple[SlaveConfig, ...]]:
    """``new`` with its links to ``running`` slaves and, if those subscribe to it, as their publisher; then the running
    slaves that do not publish yet and have to for ``new``, as they are to be. Raises ConfigError."""
    slaves = (*running, new)
    last = len(running)
    try:
        links = tuple(_links(last, slaves))
        is_wanted = any(_fits(new, slave, link) for slave in running for link in slave.params.links)
        found = _with_links(last, new, links, publishes=is_wanted)
        wanted = {link.publisher for link in links}
        return found, tuple(
            _with_links(number, slave, slave.params.links, publishes=True)
            for number, slave in enumerate(running)
            if slave.address in wanted and not slave.params.publishes
        )
    except UnlinkedError as error:
        raise ConfigError(f"add_slave: {error}; {error.todo}") from None


def _fits(new: SlaveConfig, slave: SlaveConfig, link: Link) -> bool:
    """Whether ``link`` of the running ``slave`` subscribes to ``new``. Raises ConfigError if it waits for others."""
    if link.publisher != new.address:
        return False
    if link.publisher_length != new.params.input_len:
        raise ConfigError(
            f"slave {new.name}: slave {slave.name} subscribes to station {new.address} and has a filter for "
            f"{octets_text(link.publisher_length)} of inputs, this one has {new.params.input_len}: remove {slave.name} "
            "first, and add it anew behind this one"
        )
    return True


def _links(number: int, slaves: Sequence[SlaveConfig]) -> Iterator[Link]:
    slave = slaves[number]
    for count, one in enumerate(slave.subscribes, 1):
        where = f"slave {slave.name}: subscribes {count}"
        source = next((other for other in slaves if one.publisher in (other.name, other.address)), None)
        if source is None:
            names = [other.name for other in slaves if other is not slave]
            hint = did_you_mean(str(one.publisher), names, f"there are: {', '.join(names) or 'no others'}")
            raise UnlinkedError(number, f"{where}: there is no slave {one.publisher!r}", hint)
        if source is slave:
            raise UnlinkedError(number, f"{where}: its publisher is this slave itself", "name another slave")
        length = source.params.input_len
        if one.end > length:
            what = f"{where}: octets {one.first}:{one.end}, {source.name} has {octets_text(length)} of inputs"
            raise UnlinkedError(number, what, "take octets that it has")
        slot, to = _place(number, slave, one, where)
        yield Link(source.address, length, one.first, one.end - one.first, slot, to)


def _place(number: int, slave: SlaveConfig, one: Subscription, where: str) -> tuple[int | None, int | None]:
    """Slot and octet in it, as the filter has them."""
    sinamics = slave.filter_block == SINAMICS
    if one.to is None:
        if sinamics or any(other.to is not None for other in slave.subscribes):
            raise UnlinkedError(number, f"{where}: no to", "say to which octet of its outputs they go")
        return None, None
    behind = one.to + one.end - one.first
    if behind > slave.params.output_len:
        has = octets_text(slave.params.output_len)
        what = f"{where}: to = {one.to} is octets {one.to}..{behind - 1}, this slave has {has} of outputs"
        raise UnlinkedError(number, what, "take octets that it has")
    for name, field in slave.output_fields.fields.items():
        if field.mask >> 8 * one.to & ((1 << 8 * (behind - one.to)) - 1):
            what = (
                f"{where}: octets {one.to}..{behind - 1} of its outputs come from {one.publisher}, and {name} is there"
            )
            raise UnlinkedError(number, what, f"take {name} out of outputs, or move one of the two")
    if sinamics:
        return None, one.to
    for slot in slave.params.slots.slots:
        area = slot.outputs
        if area.octets and area.at <= one.to and behind <= area.at + area.octets:
            return slot.number, one.to - area.at
    what = f"{where}: octets {one.to}..{behind - 1} of its outputs lie in several slots"
    raise UnlinkedError(number, what, "write an entry for each slot")


def _with_links(number: int, slave: SlaveConfig, links: tuple[Link, ...], *, publishes: bool) -> SlaveConfig:
    problem = (publishes and _publisher_problem(slave)) or (links and _subscriber_problem(slave, links))
    if problem:
        raise UnlinkedError(number, f"slave {slave.name}: {problem[0]}", problem[1])
    block = slave.filter_block == SINAMICS
    try:
        params = structs.replace(slave.params, publishes=publishes, links=links, sinamics_filter=block)
    except ConfigError as error:
        raise UnlinkedError(number, str(error), "correct it, or take the subscription out") from None
    return slave if params == slave.params else structs.replace(slave, params=params)


def _publisher_problem(slave: SlaveConfig) -> tuple[str, str] | None:
    device = slave.device
    if slave.params.dpv1 is None:
        return "it publishes, and dpv1 is off: Publisher_Enable stands in DPV1_Status_1", _DPV1
    if device is not None and not device.publisher:
        return "it publishes, but its GSD file does not say Publisher_supp = 1" + _revision(device), _OTHER
    return None


def _subscriber_problem(slave: SlaveConfig, links: tuple[Link, ...]) -> tuple[str, str] | None:
    device, params = slave.device, slave.params
    if params.dpv1 is None:
        return "it subscribes, and dpv1 is off: the filter is a structured parameter of DP-V1", _DPV1
    if params.watchdog_ms == 0:
        todo = "leave watchdog_ms out: without it nobody would notice a lost publisher"
        return "it subscribes with watchdog_ms = 0: the watchdog is the monitoring time of its links", todo
    if len(links) > MAX_LINKS:
        return f"{len(links)} links, {MAX_LINKS} are possible", "take fewer, longer ones"
    if (problem := link_problem(links)) is not None:
        return f"subscribes: {problem}", "correct it"
    if device is None:
        return None
    if not device.subscriber:
        return "it subscribes, but its GSD file does not say Subscriber_supp = 1" + _revision(device), _OTHER
    most, octets = device.dxb_max_link_count, sum(link.length for link in links)
    if most is not None and len(links) > most:
        return f"{len(links)} links, its GSD file says DXB_Max_Link_Count = {most}", "take fewer, longer ones"
    if device.dxb_max_data_length is not None and octets > device.dxb_max_data_length:
        said = f"DXB_Max_Data_Length = {device.dxb_max_data_length}"
        return f"its links have {octets_text(octets)}, its GSD file says {said}", "take fewer octets"
    if not (device.dpv1.prm_block_structure or device.dpv1.prm_block_structure_required):
        return "it subscribes, but its GSD file does not say Prm_Block_Structure_supp = 1", _OTHER
    return None


def _revision(device: Device) -> str:
    revision = device.gsd_revision
    older = revision is not None and revision < _DXB_REVISION
    return f" (GSD_Revision {revision}; the keyword came with {_DXB_REVISION})" if older else ""
