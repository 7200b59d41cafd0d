"""Parameter channel of a drive: common interface of PKW, makers' own channels and record 47; shared checks."""

from __future__ import annotations

import abc
from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, Protocol

from msgspec import Struct

from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.params import ParamSpec, ParamTable

_MOST_INDEX: Final = 0xFF


class ParamKey(Struct, frozen=True):
    """A parameter as a user names it. ``data_set`` and ``index`` as the drive defines them."""

    #: name or number
    name: str | int
    #: data set, as the drive counts them; None: the active one, or the drive has none
    data_set: int | None = None
    #: element or subindex, as the drive counts them; None for a plain parameter
    index: int | None = None
    #: write it to the RAM only, not to the EEPROM
    ram: bool = False

    @property
    def place(self) -> int | None:
        """Data set or index, for drives where one octet stands for either."""
        return self.index if self.data_set is None else self.data_set

    def spec_in(self, table: ParamTable) -> ParamSpec | None:
        """The entry of ``table``; None for an unknown number. Raises CommandError for an unknown name."""
        if not isinstance(self.name, str):
            return table.get(self.name)
        spec = table.named(self.name)
        if spec is None:
            raise CommandError("usage", f"no parameter is called {self.name!r}{table.hint(self.name)}")
        return spec


class MapCodes(Struct, frozen=True):
    """The parameters of the drive that hold a process data map: one for each word, in order, 0 for an empty one."""

    #: parameters of the words, in order
    places: tuple[ParamKey, ...]
    #: parameter with the number of words in use; None: all are
    count: ParamKey | None = None


class ParamRef(NamedTuple):
    """A parameter in a cyclic channel: number, IND's high octet or subindex, array orders or plain ones, its
    specification if it is known.

    ``data_set`` for messages, None if the drive has none or the parameter exists once.
    """

    #: parameter number on the wire
    pnu: int
    #: high octet of IND, or the subindex
    ind: int
    #: use the orders of arrays
    array: bool
    #: its entry in the table; None for an unknown number
    spec: ParamSpec | None
    #: the parameter for people
    label: str
    #: data set, for messages; None if the drive has none or the parameter exists once
    data_set: int | None = None


class Clock(Protocol):
    """``now``: time of the present cycle in ns."""

    now: int


class CycleTimes(Clock, Protocol):
    """The times that the handshake of a parameter channel depends on; a drive plugin has them."""

    @property
    def settle_ns(self) -> int:
        """After this time the drive's octets belong to the octets sent now."""


#: the parameter with a number and an index
FindSpec = Callable[[int, int], ParamSpec | None]
#: for each parameter its outcome, or ``error``, ``text`` and ``number`` of the refusal
Found = list[dict[str, object]]


class ParameterChannel(abc.ABC):
    """The master's end. Jobs queue; each is a generator that returns its outcome or raises CommandError.

    An outcome has ``value`` (in ``unit``), ``raw`` (the integer on the wire), ``number``, ``name``, ``unit`` and
    ``data_set``. Deadlines in ns.
    """

    #: reports a remark to people
    notice: Callable[[str], None] = staticmethod(lambda text: None)
    _remarked: frozenset[str] = frozenset()

    def remark(self, label: str, text: str | None) -> None:
        """Report ``text`` about a parameter, once for each; None: nothing to report."""
        if text is not None and label not in self._remarked:
            self._remarked |= {label}
            self.notice(f"{label}: {text}")

    @property
    def octets(self) -> bytes:
        """The octets to send in front of the process data; empty if the channel is not part of them."""
        return b""

    @property
    def busy(self) -> bool:
        """Whether :meth:`step` has to be called in every cycle."""
        return False

    @property
    def per_request(self) -> int:
        """Parameters of one request."""
        return 1

    @property
    def needs_outputs(self) -> bool:
        """Whether its octets stand in the outputs, so that it is silent in Clear."""
        return True

    @abc.abstractmethod
    def step(self, inputs: bytes, now: int) -> None:
        """Process the channel's octets in ``inputs`` (the first ones); never raises."""

    def fields(self, octets: bytes, *, order: bool, find: FindSpec) -> dict[str, object]:
        """The channel's octets of another master's ``order``, or of the drive's reply, for a program that only
        listens: plain JSON data, empty if there is no order. ``text``: all of it in a few words.
        """
        return {}

    @abc.abstractmethod
    def reset(self) -> None:
        """The slave left data exchange: all jobs are cancelled."""

    @abc.abstractmethod
    def read(self, key: ParamKey, deadline: int) -> Steps[dict[str, object]]: ...

    @abc.abstractmethod
    def write(self, key: ParamKey, value: float, deadline: int) -> Steps[dict[str, object]]:
        """Write one parameter; ``value`` in its unit, or the integer on the wire if its scale is unknown."""

    def read_raw(self, key: ParamKey, deadline: int) -> Steps[int]:
        """Read one parameter: the integer on the wire."""
        raw = (yield from self.read(key, deadline))["raw"]
        assert isinstance(raw, int)
        return raw

    def read_many(self, keys: Sequence[ParamKey], deadline: int) -> Steps[Found]:
        """Read ``keys``: an entry for each. Raises CommandError, but not for a refusal by the drive."""
        found: Found = []
        for key in keys:
            try:
                found.append((yield from self.read(key, deadline)))
            except CommandError as error:
                found.append(refused(error))
        return found


class ChannelServer(Protocol):
    """The drive's end, called once a scan."""

    def reset(self) -> None: ...

    def step(self, octets: bytes) -> bytes:
        """The reply to the octets of the order area (:data:`CHANNEL_LEN` both)."""


def find_parameter(key: ParamKey, table: ParamTable, most: int) -> tuple[ParamSpec | None, int, str]:
    """Entry of ``table``, number and label of a parameter named by name or number; None for an unknown number.

    Raises CommandError for an unknown name, and for a number that is not 1..``most``.
    """
    spec = key.spec_in(table)
    number = spec.number if spec is not None else int(key.name)
    label = f"parameter {number if spec is None else spec.label}"
    if not 1 <= number <= most:
        raise CommandError("usage", f"{label}: parameter numbers are 1..{most}")
    return spec, number, label


class ChannelDialect(Protocol):
    """A layout of the channel: parameter numbers up to ``most``, indexes (``arrays``), writes to RAM only."""

    @property
    def most(self) -> int: ...
    @property
    def arrays(self) -> bool: ...
    @property
    def ram(self) -> bool: ...


def plain_ref(key: ParamKey, table: ParamTable, drive: str, dialect: ChannelDialect) -> ParamRef:
    """A parameter of ``table`` by name or number, elements of arrays by index if the dialect has them; a number that
    is not in the table goes as it is, without a scale."""
    spec, number, label = find_parameter(key, table, dialect.most)
    if key.data_set is not None or (key.index is not None and not dialect.arrays):
        lacks = "no data sets" if dialect.arrays else "neither data sets nor indexes"
        raise CommandError("usage", f"{label}: {drive} has {lacks}")
    if key.ram and not dialect.ram:
        raise CommandError("usage", f"{label}: {drive} has no writes to RAM only")
    index = key.index if key.index is not None else 0 if spec is None else spec.index
    if index > _MOST_INDEX:
        raise CommandError("usage", f"{label}: indexes are 0..{_MOST_INDEX}")
    return ParamRef(number, index, key.index is not None or index > 0, spec, label)


def check_write(spec: ParamSpec | None, label: str, value: float) -> int | None:
    """The integer of ``value``; None for an unknown parameter. Raises CommandError if it cannot be written."""
    if spec is None:
        return None
    if spec.read_only:
        raise CommandError("usage", f"{label} is read only")
    try:
        return spec.to_raw(value)
    except ValueError as error:
        raise CommandError("usage", str(error)) from None


def outcome(spec: ParamSpec | None, number: int, value: object, raw: int, data_set: int | None) -> dict[str, object]:
    """The outcome of a job, see :class:`ParameterChannel`."""
    name, unit = (spec.name, spec.unit) if spec is not None else (None, "")
    return {"value": value, "raw": raw, "number": number, "name": name, "unit": unit, "data_set": data_set}


def refused(error: CommandError) -> dict[str, object]:
    """The entry of a parameter that the drive refused; any other error is raised again."""
    if error.kind != "parameter":
        raise error
    return {"error": error.kind, "text": error.text, "number": error.number}
