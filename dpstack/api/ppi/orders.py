"""Orders of ``dpstack ppi``, one request to an S7-200 by hand: words, parser, execution, answers in JSON."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from typing import Final, Protocol

from msgspec import Struct

from dpstack.api.fdl.fdl import Fdl
from dpstack.api.ppi.cpu import Cpu
from dpstack.api.ppi.poll_plan import pdu_length_of
from dpstack.api.ppi.polling import READ_ONLY, CpuPolling, PollingBus
from dpstack.errors import UsageError
from dpstack.ppi.addresses import PpiAddress, PpiValue, parse_address
from dpstack.text import brief, decimal, shortened

READ, WRITE, RUN, STOP, CLOCK, SET_TIME = ACTIONS = ("read", "write", "run", "stop", "clock", "set-time")
#: actions that the plant notices
ACTING: Final = (WRITE, RUN, STOP, SET_TIME)
LAST_CPU: Final = 125
_BITS: Final[Mapping[str, bool]] = {
    "1": True,
    "true": True,
    "on": True,
    "0": False,
    "false": False,
    "off": False,
}
#: a line for people as ``text``, beside the values for programs
Line = dict[str, object]


class PpiOrder(Struct, frozen=True):
    """One order, whose words are right. ``addresses``: of read, or the one of write; ``value``: of write; ``time``: of
    set-time, None for the computer's local time."""

    action: str
    address: int
    words: tuple[str, ...]
    addresses: tuple[PpiAddress, ...] = ()
    value: PpiValue | None = None
    time: datetime.datetime | None = None

    @property
    def control_words(self) -> tuple[str, ...]:
        """The order for the control socket."""
        return (str(self.address), self.action, *self.words)


def ppi_order(action: str, address: int, words: Sequence[str]) -> PpiOrder:
    """The order ``action`` to the CPU ``address`` with its ``words``. Raises UsageError."""
    match action:
        case "read":
            if not words:
                raise UsageError("read needs addresses, for instance: read VW100 M0.3")
            return PpiOrder(action, address, tuple(words), tuple(map(parse_address, words)))
        case "write":
            if len(words) != 2:
                raise UsageError("write needs an address and a value, for instance: write VW100 250")
            place = parse_address(words[0])
            return PpiOrder(action, address, tuple(words), (place,), _value(place, words[1]))
        case "set-time":
            if len(words) > 1:
                raise UsageError("set-time takes one time, for instance 2026-11-28T12:00")
            return PpiOrder(action, address, tuple(words), time=_time(words[0]) if words else None)
    if action not in ACTIONS:
        raise UsageError(f"{shortened(action)!r} is no order for a CPU; there are: {', '.join(ACTIONS)}")
    if words:
        raise UsageError(f"{action} takes no {brief(words[0])}: leave it out")
    return PpiOrder(action, address, ())


def parse_ppi_order(words: Sequence[str]) -> PpiOrder:
    """The order in :attr:`PpiOrder.control_words`. Raises UsageError."""
    address, action, *more = words
    station = decimal(address)
    if station is None or station > LAST_CPU:
        raise UsageError(f"{shortened(address)!r} is no station address of an S7-200: 0..{LAST_CPU}")
    return ppi_order(action, station, more)


def _value(address: PpiAddress, text: str) -> PpiValue:
    """The value that ``text`` means at ``address``. Raises UsageError."""
    value: PpiValue
    try:
        if address.size == 1:
            value = _BITS[text.lower()]
        elif not address.code:
            value = bytes.fromhex(text)
        else:
            value = float(text) if address.code == "f" else int(text, 0)
    except (KeyError, ValueError):
        wanted = "0 or 1" if address.size == 1 else "octets in hex" if not address.code else "a number"
        raise UsageError(f"{address.text}: {brief(text)} is no value; {wanted} is wanted") from None
    address.octets(value)
    return value


def _time(text: str) -> datetime.datetime:
    try:
        return datetime.datetime.fromisoformat(text)
    except ValueError:
        raise UsageError(f"{brief(text)} is no time; for instance 2026-11-28T12:00") from None


async def carry_out(cpu: Cpu, order: PpiOrder) -> list[Line]:
    """The outcome, one line for each value. Raises as :class:`~dpstack.api.ppi.cpu.Cpu` does."""
    who = f"CPU {cpu.address}"
    match order.action:
        case "read":
            values = await cpu.read_all([address.text for address in order.addresses])
            return [_shown(address, value) for address, value in zip(order.addresses, values, strict=True)]
        case "write":
            (address,), value = order.addresses, order.value
            assert value is not None
            await cpu.write(address.text, value)
            line = _shown(address, value)
            return [line | {"text": f"{line['text']}, written"}]
        case "run":
            await cpu.run()
            return [{"text": f"{who} is in RUN"}]
        case "stop":
            await cpu.stop()
            return [{"text": f"{who} is in STOP"}]
        case "clock":
            time = await cpu.clock()
            return [{"time": time.isoformat(), "text": f"{who}: {time:%Y-%m-%d %H:%M:%S}"}]
    time = order.time or datetime.datetime.now().astimezone()
    await cpu.set_clock(time)
    return [{"time": time.isoformat(), "text": f"{who}: set to {time:%Y-%m-%d %H:%M:%S}"}]


def _shown(address: PpiAddress, value: PpiValue) -> Line:
    if isinstance(value, bytes):
        return {"name": address.text, "value": value.hex(), "text": f"{address.text}: {value.hex(' ').upper()}"}
    text = str(int(value)) if isinstance(value, bool) else f"{value:g}" if isinstance(value, float) else str(value)
    return {"name": address.text, "value": value, "text": f"{address.text}: {text}"}


# --- through a run ----------------------------------------------------------------------------------------------------
class RunningBus(PollingBus, Protocol):
    """The bus of a run, which polls ``cpus``."""

    cpus: dict[int, CpuPolling]


async def carry_out_beside(bus: RunningBus, words: Sequence[str], others: dict[int, Cpu]) -> list[Line]:
    """Carry out the order ``words`` beside the DP master. Of a CPU of the plant file everything may be read, and the
    values in its ``allow_commands`` may be written; ``others`` keeps the CPUs that are not in it. Raises UsageError,
    and as :func:`carry_out`."""
    order = parse_ppi_order(words)
    bus.check_open()
    if bus.config.bus.read_only:
        raise UsageError(READ_ONLY)
    polling = bus.cpus.get(order.address)
    if polling is None:
        if order.address not in others:
            others[order.address] = Cpu(Fdl(bus.fdl_link()), order.address, pdu_length=pdu_length_of(bus.plan))
        return await carry_out(others[order.address], order)
    if order.action in ACTING:
        _check_allowed(polling, order)
    lines = await carry_out(polling.cpu, order)
    if order.action in ACTING:
        polling.poll_now()
    return lines


def _check_allowed(polling: CpuPolling, order: PpiOrder) -> None:
    """Raises UsageError for an order that the plant file does not leave to others."""
    config = polling.config
    if order.action != WRITE:
        raise UsageError(
            f"{config.who} belongs to the plant of this run, which writes values that allow_commands lists, and leaves "
            f"mode and clock alone: for {order.action} end the run first"
        )
    (wanted,) = order.addresses
    allowed = [config.values[name].address for name in config.output_fields]
    if not any(wanted.item == one.item for one in allowed):
        known = ", ".join(one.text for one in allowed) or "none"
        raise UsageError(
            f"{config.who}: {wanted.text} is not written for others by this run, whose plant file allows: {known}; "
            "name the value there, and list it in allow_commands of this CPU"
        )
