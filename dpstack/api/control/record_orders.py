"""Orders to the records of a slave (``read``, ``write`` ...): words, parser, execution, answers in JSON."""

from __future__ import annotations

import functools
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final, NamedTuple

from msgspec import structs

from dpstack.api.bus.bus import Bus
from dpstack.api.bus.parts import SEARCHING
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.control.arguments import hex_octets, within
from dpstack.api.control.commands import Arguments, ParsedCommand, Spec, find_word
from dpstack.api.control.control_server import LongCommand, Send, kept_alive
from dpstack.api.lists.record_list import ListedValues
from dpstack.api.slave.class2 import Connection
from dpstack.api.slave.slave import Slave
from dpstack.dp.pdu.layouts import MAX_RECORD, MAX_SLOT
from dpstack.dpv1.pdu.im import Im, Im0
from dpstack.errors import AcyclicError, BusError, HartError, ParameterError, PduError, SlaveFault, UsageError
from dpstack.profile import error_text
from dpstack.profile.record47 import Address, ErrorValue, Progress, ReadParameter, Values, format_of
from dpstack.profile.record47.formats import VISIBLE_STRING
from dpstack.profile.record47.param_lists import item_of
from dpstack.text import number_or_name, octets_text

PARAMETERS: Final = "parameters"
#: an order of `dpstack pa`
PA: Final = "pa"
#: one parameter of record 47
PARAMETER: Final = "parameter"
WORDS: Final = (
    Spec("read", "SLOT INDEX [LENGTH]", "a record, as hex; LENGTH: the most octets to read", "1 47"),
    Spec("write", "SLOT INDEX HEX", "all octets of a record", "1 47 00FF"),
    Spec(
        PARAMETERS, "[SLOT] [OBJECT]", "the device's own list of parameters (PROFIdrive, 980 to 989), all values", "1"
    ),
    Spec(PARAMETER, "PNU [SLOT] [OBJECT]", "one parameter: 1120, 947:3 (an element); 1120=2.5 writes it", "1120"),
    Spec("stamps", "INDEX", "time-stamped events of a record, 100 to 115, as a process alarm announces them", "100"),
    Spec("im", "[SLOT]", "I&M0, and those of I&M1 to 4 that it says there are", ""),
    Spec(
        "hart",
        "SLOTS CHANNEL [FORMAT] [COMMAND] [HEX]",
        "a HART transmitter, or all channels; SLOTS: 2, or 1-4, of which one has a HART module",
        "2 0 transparent 3",
    ),
    Spec(
        PA,
        "[ORDER] [NAME] [VALUE] [TIMEOUT]",
        "a process device of PROFIBUS PA, as the command pa has it; last timeout=30: in s, for each Read and Write",
        "read ai1.out",
    ),
)
#: orders of `dpstack acyclic` only, by means of PARAMETERS: a run writes no files
DUMP, COMPARE = "dump", "compare"
TRANSPORT: Final = Spec("transport", "SLOT INDEX [HEX]", "Data_Transport (class 2): to the slave and back", "0 1 00FF")
#: the commands of a run, by class of master
COMMANDS: Final = {1: "acyclic", 2: "class2"}
#: in place of a HART channel: the module with its channels
ALL_CHANNELS: Final = "all"
#: formats of HART requests: transparent, compact
FORMATS: Final = ("transparent", "compact")
#: parameters in one line of an answer, far fewer octets than the server keeps for a slow reader
_IN_A_LINE: Final = 100

#: called with the name of the step, the number done, the total number
OnProgress = Callable[[str, int, int], None]


def parse_order(word: str, args: Sequence[str], *, class2: bool = False, who: str = "dpstack acyclic") -> ParsedCommand:
    """Parse one of :data:`WORDS`, or :data:`TRANSPORT` with ``class2``. Raises UsageError; ``who``: its subject."""
    if word == TRANSPORT.name and not class2:
        raise UsageError("Data_Transport is a service of class 2 connections: add --class 2 (`ctl`: class2)")
    return find_word(word, (*WORDS, TRANSPORT) if class2 else WORDS, who).order(args, _ARGUMENTS)


def check_order(order: ParsedCommand, slave: SlaveConfig) -> None:
    """Raises UsageError for a write of a parameter past the plugin of a drive."""
    wanted = order.values.get("wanted")
    if slave.has_drive and isinstance(wanted, _Wanted) and wanted.value is not None:
        name, has = "DRIVE", "has drives with plugins, which know"
        if slave.profile is not None:
            name, has = slave.name, f"has the plugin {slave.profile.name}, which knows"
        raise UsageError(
            f"{slave.name} {has} limits and what must not change while the "
            f"motor turns: `dpstack drive CONFIG {name} write {wanted.pnu} {wanted.value}` writes it"
        )


def acyclic_order(bus: Bus, args: list[str], *, class2: bool = False) -> LongCommand:
    """``SLAVE ORDER [ARG]...`` to a slave of a run; with ``class2`` over a new connection, which is closed afterwards.
    A client that closes its socket cancels the order.

    Items have the ``state`` of the slave and ``progress``; a long list comes in items before the result.
    """
    if bus.searching:
        raise BusError(f"{SEARCHING}: the slaves are known once it is found")
    name, word, *texts = args
    slave = bus.slave(number_or_name(name))
    who = f"ctl {COMMANDS[2 if class2 else 1]}"
    if word in (DUMP, COMPARE):
        with_class = " --class 2" if class2 else ""
        raise UsageError(
            f"{who} has no files: `dpstack acyclic CONFIG {name} {word} FILE{with_class}` has, and goes through this "
            f"run; {PARAMETERS} gives the same list"
        )
    order = parse_order(word, texts, class2=class2, who=who)
    check_order(order, slave.config)
    progress: list[object] = []

    def sign() -> dict[str, object]:
        return {"state": slave.state.value, **({"progress": progress} if progress else {})}

    def on_progress(*step: object) -> None:
        progress[:] = step

    async def work() -> dict[str, Any]:
        if not class2:
            return await carry_out(slave, order, on_progress)
        async with bus.class2.connect(slave) as connection:
            return await carry_out(connection, order, on_progress)

    async def long_command(send: Send) -> dict[str, Any]:
        answer = await kept_alive(work(), sign, send)
        found = answer.pop(PARAMETERS, ())
        for at in range(0, len(found), _IN_A_LINE):
            await send({PARAMETERS: found[at : at + _IN_A_LINE]})
        return answer

    return long_command


async def carry_out(
    slave: Slave | Connection, order: ParsedCommand, progress: OnProgress | None = None
) -> dict[str, Any]:
    """Carry out ``order``. Returns the answer as plain data. Raises the errors of :meth:`Slave.read`.

    The order ``parameters`` also raises those of :class:`~dpstack.api.slave.record_parameters.RecordParameters`, and
    calls ``progress``.
    """
    word, values = order.word, order.values
    head: dict[str, Any] = {"order": word, "slave": slave.name, "address": slave.address}
    match word:
        case "read" | "write" | "transport":
            data: bytes = values.get("data", b"")
            if word == "read":
                data = await slave.read(**values)
            elif word == "write":
                await slave.write(**values)
            else:
                assert isinstance(slave, Connection)
                data = await slave.transport(**values)
            answer = {**head, "slot": values["slot"], "index": values["index"], "length": len(data)}
            return answer if word == "write" else {**answer, "data": data.hex()}
        case "stamps":
            events = await slave.read_time_stamps(values["index"])
            return {**head, "slot": 0, "index": values["index"], "events": [one.as_dict() for one in events]}
        case "parameters":
            place = {"slot": 1, "object": 1, **values}
            return {**head, **place, **await _all_parameters(slave, place, progress)}
        case "hart":
            return {**head, **await _hart(slave, values, progress)}
        case "pa":
            from dpstack.api.pa.orders import carry_out as carry_out_pa  # here, as few slaves are process devices

            return {**head, **await carry_out_pa(slave.pa, tuple(values.values()), progress)}
        case "parameter":
            wanted: _Wanted = values["wanted"]
            place = {name: values.get(name, 1) for name in ("slot", "object")}
            answer = {**head, **place, "index": wanted.element, "written": wanted.value is not None}
            return {**answer, "parameter": await _one_parameter(slave, wanted, place)}
        case _:
            return {**head, "slot": values.get("slot", 0), "im": await _all_im(slave, values.get("slot", 0))}


async def _all_parameters(
    slave: Slave | Connection, place: dict[str, int], progress: OnProgress | None
) -> dict[str, object]:
    def counter(what: str) -> Progress | None:
        return None if progress is None else lambda done, of: progress(what, done, of)

    parameters = slave.parameters(**place)
    found = await parameters.read_out(progress=counter("values"), describing=counter("descriptions"))
    return {"ident": await _ident_of(slave), "parameters": [ListedValues.of(one).as_dict() for one in found]}


async def _hart(slave: Slave | Connection, values: Mapping[str, Any], progress: OnProgress | None) -> dict[str, object]:
    """A command, all that a transmitter says of itself, or the module with its channels: as numbers, and as rows for
    people."""
    from dpstack.hart.commands import READ_STATUS, decoded  # here, as few programs use HART

    slots, channel = values["slots"], values["channel"]
    slot = slots[0] if len(slots) == 1 else await _hart_slot(slave, slots, channel or 0)
    if channel is None:
        return await _hart_channels(slave, slot, progress)
    device = slave.hart(channel, slot=slot, compact=values.get("compact", False))
    head = {"slot": slot, "channel": channel}
    number = values.get("command")
    if number is None:
        reading = await device.read()
        return {**head, "command": None, **reading.as_dict(), "rows": reading.rows}
    answer = await device.command(number, values.get("data", b""))
    revision = (await device.identity()).revision if number == READ_STATUS else 0
    try:
        rows = decoded(number, answer.data, revision)
    except PduError as error:
        raise SlaveFault(slave.address, f"slave {slave.address} ({slave.name}): {error}") from None
    status = "; ".join(answer.device_status_texts) or "good"
    return {
        **head,
        "command": number,
        "response_code": answer.response_code,
        "device_status": list(answer.device_status_texts),
        "data": answer.data.hex(),
        "rows": [*rows, ("device status", status)]
        + ([("response", answer.response_text)] if answer.response_code else []),
    }


async def _hart_channels(slave: Slave | Connection, slot: int, progress: OnProgress | None) -> dict[str, object]:
    """Directory and features of a module, and at each of its channels the device, or the reason for an error."""
    directory, features = await slave.hart(0, slot=slot).module()
    rows = [
        ("HART channels", str(directory.channels)),
        ("profile revision", "{}.{}".format(*directory.revision)),
        ("request records", ", ".join(map(str, directory.requests))),
        ("formats", "transparent, compact" if features.compact else "transparent"),
        ("longest record", octets_text(features.longest)),
    ]
    channels: list[dict[str, object]] = []
    for number in range(directory.channels):
        if progress is not None:
            progress("channels", number, directory.channels)
        try:
            reading = await slave.hart(number, slot=slot).read()
        except HartError as error:
            why = str(error).rpartition(f"channel {number}: ")[2]
            rows.append((f"channel {number}", why))
            channels.append({"channel": number, "error": why})
            continue
        values = [one.text for one in reading.variables.variables] if reading.variables is not None else []
        tag = [reading.tag.tag] if reading.tag is not None else []
        rows.append((f"channel {number}", ", ".join((*tag, *values, reading.identity.maker, *reading.device_status))))
        channels.append({"channel": number, **reading.as_dict()})
    return {"slot": slot, "channel": None, "command": None, "channels": channels, "rows": rows}


async def _hart_slot(slave: Slave | Connection, slots: Sequence[int], channel: int) -> int:
    """The only one of ``slots`` with a HART module. Raises HartError without one, UsageError for several."""
    found: list[int] = []
    none = f"slave {slave.address} ({slave.name}): none of its slots {slots[0]} to {slots[-1]} has a HART module"
    missing = HartError(slave.address, none, reason="absent")
    for slot in slots:
        try:
            await slave.hart(channel, slot=slot).module()
        except HartError as error:
            if error.reason not in ("absent", "channel"):
                raise
            missing = error if error.reason == "channel" else missing
        else:
            found.append(slot)
    if not found:
        raise missing
    if len(found) > 1:
        names = ", ".join(map(str, found))
        raise UsageError(f"{slave.name}: the slots {names} have HART modules: name one, for instance --slot {found[0]}")
    return found[0]


class _Wanted(NamedTuple):
    """A parameter as typed: an element of an array; ``value``: text to write, None to read."""

    pnu: int
    element: int | None
    value: str | None


async def _one_parameter(slave: Slave | Connection, wanted: _Wanted, place: dict[str, int]) -> dict[str, object]:
    """Read a parameter over record 47, or write it and read it back. Raises ParameterError with the drive's reason."""
    config = slave.config if isinstance(slave, Slave) else None
    parameters = slave.parameters(**place)
    try:
        (description,) = await parameters.describe([wanted.pnu])
    except (ParameterError, SlaveFault, UsageError) as error:
        if config is None or not config.has_drive:
            raise
        name = "DRIVE" if config.drives else slave.name
        advice = f"`dpstack drive CONFIG {name} read {wanted.pnu}`"
        raise UsageError(f"{error}; {advice} asks over the parameter channel of its telegram") from None

    async def read() -> ReadParameter:
        item = item_of(wanted.pnu, description)
        if wanted.element is not None:
            item = item._replace(address=Address(wanted.pnu, wanted.element, 1))
        (result,) = await parameters.read([item])
        if isinstance(result, ErrorValue):
            raise ParameterError(slave.name, result.number, f"{slave.name}: {item.address}: {error_text(*result)}")
        return ReadParameter(wanted.pnu, description, result)

    found = await read()
    if wanted.value is not None:
        address = Address(wanted.pnu, wanted.element or 0, 0 if wanted.element is None else 1)
        (result,) = await parameters.change([(address, _values_of(found, wanted.value, str(address)))])
        if isinstance(result, ErrorValue):
            raise ParameterError(slave.name, result.number, f"{slave.name}: {address}: {error_text(*result)}")
        found = await read()
    return ListedValues.of(found).as_dict()


def _values_of(found: ReadParameter, text: str, what: str) -> Values:
    """``text`` in the format of the parameter, as the drive answers it. Raises UsageError."""
    form, result = found.format, found.result
    assert form is not None
    assert isinstance(result, Values)
    if len(found.values) != 1:
        raise UsageError(f"{what} has {len(found.values)} values: write an element of it, {found.pnu}:0=VALUE")
    try:
        value = text if form.number == VISIBLE_STRING else float(text) if "." in text or "e" in text else int(text, 0)
        octets = form.pack((form.raw(value),))
        return Values(result.format, format_of(result.format).unpack(octets))
    except ValueError as error:
        raise UsageError(f"{what} = {text}: {error}") from None


def _wanted(text: str) -> _Wanted:
    match = _WANTED.fullmatch(text)
    if match is None:
        raise UsageError(f"{text!r}: write a parameter as 1120, 947:3 (an element of an array) or 1120=2.5")
    pnu, element, value = match.groups()
    highest = 0xFFFF
    return _Wanted(
        _number("PNU", highest, pnu), None if element is None else _number("element", highest, element), value
    )


async def _ident_of(slave: Slave | Connection) -> int:
    if isinstance(slave, Connection):
        return await slave.ident()
    if slave.setup.ident is not None:
        return slave.setup.ident
    return 0 if slave.diagnosis is None else slave.diagnosis.ident  # ident = "ask": known in data exchange


async def _all_im(slave: Slave | Connection, slot: int) -> dict[str, dict[str, object]]:
    im0 = await slave.im(0, slot=slot)
    found: dict[str, dict[str, object]] = {"0": _plain(im0)}
    for number in range(1, 5):
        if isinstance(im0, Im0) and im0.supported & (1 << number):
            try:
                found[str(number)] = _plain(await slave.im(number, slot=slot))
            except (AcyclicError, SlaveFault) as error:  # although I&M0 announces it
                found[str(number)] = {"error": str(error)}
    return found


def _plain(record: Im) -> dict[str, object]:
    fields = structs.asdict(record)
    return {name: value.hex() if isinstance(value, bytes) else value for name, value in fields.items()}


def _slots(text: str) -> tuple[int, ...]:
    """``2``, or ``1-4``."""
    first, dash, last = text.partition("-")
    numbers = [_number("slot", MAX_SLOT, part) for part in (first, last if dash else first)]
    if numbers[0] > numbers[1]:
        raise UsageError(f"{text!r}: write slots as 2, or 1-4")
    return tuple(range(numbers[0], numbers[1] + 1))


def _channel(text: str) -> int | None:
    """A channel, or ``all``: None."""
    return None if text == ALL_CHANNELS else _number("CHANNEL", MAX_SLOT, text)


def _compact(text: str) -> bool:
    if text not in FORMATS:
        raise UsageError(f"{text!r} is no HART format: {' or '.join(FORMATS)}")
    return text == FORMATS[1]


def _number(name: str, highest: int, text: str) -> int:
    read = functools.partial(int, base=0)
    return within(text, read, 0, highest, f"{name}: write a number 0..{highest}, 0x2F for instance")


_WANTED: Final = re.compile(r"(\w+)(?::(\w+))?(?:=(.*))?", re.DOTALL)
#: the names in the usages of :data:`WORDS`, as keyword arguments of the methods of a slave
_ARGUMENTS: Final[Arguments] = {
    "PNU": ("wanted", _wanted),
    "SLOTS": ("slots", _slots),
    "CHANNEL": ("channel", _channel),
    "FORMAT": ("compact", _compact),
    **{name: (name.lower(), str) for name in ("ORDER", "NAME", "VALUE", "TIMEOUT")},
    "HEX": ("data", functools.partial(hex_octets, advice="write octets as 00FF")),
    **{
        name: (name.lower(), functools.partial(_number, name, highest))
        for name, highest in (
            ("SLOT", MAX_SLOT),
            ("INDEX", 255),
            ("LENGTH", MAX_RECORD),
            ("OBJECT", 255),
            ("COMMAND", 255),
        )
    },
}
