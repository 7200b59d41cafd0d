"""The orders of ``dpstack pa`` with their answers in JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple, NotRequired, TypedDict

from msgspec import structs

from dpstack.api.pa.device import OnProgress, PaDevice
from dpstack.api.pa.overview import Diagnosis, Identity
from dpstack.errors import UsageError
from dpstack.text import brief, did_you_mean

SHOW, READ, WRITE, DUMP, COMPARE = "show", "read", "write", "dump", "compare"


class Word(NamedTuple):
    """An order. ``usage``: its arguments; ``least``, ``most``: their number, None: any."""

    name: str
    usage: str
    text: str
    example: str
    least: int
    most: int | None


#: the orders; a run has the first four
WORDS: Final = (
    Word(SHOW, "", "identity, diagnosis, blocks with values, modes and alarms; also without an order", "", 0, 0),
    Word(
        READ, "NAME", "a parameter (ai1.pv_scale), a whole block (ai1), or a record by slot and index (1:110)", "", 1, 1
    ),
    Word(WRITE, "NAME VALUE", "a parameter: checked before, read back after", "tb1.lower_range 0", 2, None),
    Word(DUMP, "[FILE]", "all parameters, into a file or as a list", "tank.toml", 0, 1),
    Word(COMPARE, "FILE|NAME", "where the device differs from such a file, or from another slave", "tank2", 1, 1),
)
_BY_NAME: Final = {word.name: word for word in WORDS}
#: arguments of an order without its time limit
_PLAIN: Final = {SHOW: 0, READ: 1, WRITE: 2, DUMP: 0}
_TIMEOUT: Final = "timeout="
_LONGEST_S: Final = 3600
#: parameters whose write makes the device act at once: a valve can move, settings are lost
_ACTS: Final = {
    "factory_reset": "the device is reset: its settings are lost, and a valve can move",
    "self_calib_cmd": "the valve moves over its whole travel",
}


def checked_order(word: str, args: Sequence[str], who: str = "dpstack pa") -> tuple[str, ...]:
    """The order ``word`` with its arguments, as the run takes them. Raises UsageError; ``who``: its subject."""
    found = _BY_NAME.get(word)
    if found is None:
        raise UsageError(f"{who} does not know {word!r}; {did_you_mean(word, _BY_NAME, f'it knows {_names()}')}")
    if len(args) < found.least or (found.most is not None and len(args) > found.most):
        example = f", for instance: {word} {found.example}" if found.example else ""
        raise UsageError(f"{word} takes {found.usage or 'no arguments'}{example}")
    return (word, *args)


def timeout_argument(seconds: float | None) -> tuple[str, ...]:
    """The last argument of an order with a time limit, in s, for each Read and Write."""
    return () if seconds is None else (f"{_TIMEOUT}{seconds:g}",)


def action_of(name: str) -> str | None:
    """The effect of a write to the parameter ``name``, if the device acts at once, or may: by slot and index."""
    if ":" in name:
        return "by slot and index it can be one that resets the device or moves a valve"
    return _ACTS.get(name.strip().lower().partition(".")[2])


def _timed(order: Sequence[str]) -> tuple[Sequence[str], float | None]:
    """The order without its time limit, and the limit in s. A last argument where a value belongs is a value."""
    if not order or len(order) != _PLAIN.get(order[0], len(order)) + 2 or not order[-1].startswith(_TIMEOUT):
        return order, None
    text = order[-1].removeprefix(_TIMEOUT)
    try:
        seconds = float(text)
    except ValueError:
        seconds = 0.0
    if not 0 < seconds <= _LONGEST_S:
        raise UsageError(f"{_TIMEOUT}{brief(text)}: write seconds, more than 0, at most {_LONGEST_S}")
    return order[:-1], seconds


def _names() -> str:
    return ", ".join(_BY_NAME)


class PaValueFields(TypedDict):
    """A parameter in an answer: with ``text``, or with ``unreadable``."""

    name: str
    slot: int
    index: int
    type: str
    access: str
    text: NotRequired[str]
    unreadable: NotRequired[str]
    quality: NotRequired[str]


class BlockFields(TypedDict):
    """A block in the answer to :data:`SHOW`."""

    name: str
    kind: str
    slot: int
    index: int
    tag: str
    target_mode: str
    mode: str
    alarms: str
    values: list[PaValueFields]


class _Of(TypedDict):
    slave: str
    address: int
    asked: str


class ShowAnswer(_Of):
    """The answer to :data:`SHOW`."""

    identity: Identity
    diagnosis: Diagnosis
    write_protection: str
    directory: int | None
    remarks: list[str]
    parameters: list[BlockFields]


class ReadAnswer(_Of):
    """The answer to :data:`READ`."""

    name: str
    parameters: list[PaValueFields]


class WriteAnswer(_Of):
    """The answer to :data:`WRITE`."""

    name: str
    text: str
    parameter: PaValueFields


class DumpAnswer(_Of):
    """The answer to :data:`DUMP`; the parameters are those of :class:`~dpstack.api.pa.pa_list.PaEntry`."""

    maker: int
    device: str
    serial: str
    profile: str
    remarks: list[str]
    parameters: list[PaEntryFields]


class PaEntryFields(TypedDict):
    """A parameter of a dump."""

    name: str
    slot: int
    number: int
    type: str
    group: str
    values: NotRequired[list[int | float | bool | str | None]]
    text: NotRequired[str]
    unreadable: NotRequired[str]
    read_only: NotRequired[bool]


#: the fields of an answer by order
ANSWERS: Final[dict[str, type]] = {SHOW: ShowAnswer, READ: ReadAnswer, WRITE: WriteAnswer, DUMP: DumpAnswer}


async def carry_out(device: PaDevice, order: Sequence[str], progress: OnProgress | None = None) -> dict[str, Any]:
    """Carry out :data:`SHOW`, :data:`READ`, :data:`WRITE` or :data:`DUMP`. Returns the answer as plain data; a long
    list in it has the key ``parameters``. Raises the errors of :class:`PaDevice`."""
    order, timeout = _timed(order)
    word, *args = checked_order(order[0], order[1:]) if order else (SHOW,)
    head: dict[str, Any] = {"asked": word}
    match word:
        case "read":
            (name,) = args
            found = await device.read_any(name, timeout=timeout, progress=progress)
            return {**head, "name": name, "parameters": [one.as_dict() for one in found]}
        case "write":
            name, *words = args
            written = await device.write(name, " ".join(words), timeout=timeout)
            before, value = written.before.as_dict(), written.value.as_dict()
            more = {"st_rev": list(written.st_rev), "text": written.text}
            return {**head, "name": written.name, "before": before, "parameter": value, **more}
        case "dump":
            dumped = await device.dump(timeout=timeout, progress=progress)
            keys = {key: getattr(dumped.list, key) for key in ("maker", "device", "serial", "profile")}
            entries = [one.for_json() for one in dumped.list.parameters]
            return {**head, **keys, "remarks": list(dumped.remarks), "parameters": entries}
    overview = await device.overview(timeout=timeout, progress=progress)
    return {
        **head,
        "identity": structs.asdict(overview.identity),
        "diagnosis": {key: _listed(value) for key, value in structs.asdict(overview.diagnosis).items()},
        "write_protection": overview.write_protection,
        "directory": overview.directory,
        "remarks": list(overview.remarks),
        "parameters": [block.as_dict() for block in overview.blocks],
    }


def _listed(value: object) -> object:
    return list(value) if isinstance(value, tuple) else value
