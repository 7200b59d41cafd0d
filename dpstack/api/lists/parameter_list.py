"""``ParameterList``: the parameters of a drive, dumped into a file and compared with it, beside the cyclic data.

The file is TOML with one line a parameter, so `diff` can compare two of them.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import ClassVar, Final, Protocol

from dpstack.api.files import AtomicFile
from dpstack.api.lists.list_file import Difference, ListComparison, ListEntry, SavedList, is_same, pairs_of, time_now
from dpstack.errors import ConfigError, DriveError, DriveTimeout, ParameterError, UsageError
from dpstack.profile import ListedParam, count_of

#: number of parameters without an answer, one after the other, that ends a dump
_SILENT: Final = 3

#: called after each parameter: number read, total number, the last one
OnParameter = Callable[[int, int, "SavedParam"], None]
#: fields that an entry takes from the declared parameter
_DECLARED: Final = ("name", "number", "title", "subindex", "data_set", "index", "read_only")
#: the key of a parameter: its name in lower case, its data set and its element, if it has several
Place = tuple[str, int | None, int | None]


@dataclass(frozen=True, slots=True, kw_only=True)
class SavedParam(ListEntry):
    """A parameter of a drive: ``value`` in ``unit``, or None."""

    KEYS: ClassVar = {
        "name": str,
        "number": int,
        "subindex": int,
        "data_set": int,
        "index": int,
        "value": float,
        "unit": str,
        "unreadable": str,
        "read_only": bool,
        "title": str,
    }
    VALUES = "value", "unit"
    OMITTED: ClassVar = {"subindex": 0, "data_set": None, "index": None, "read_only": False}

    title: str = ""
    subindex: int = 0
    data_set: int | None = None
    index: int | None = None
    value: float | int | None = None
    unit: str = ""

    @classmethod
    def of(cls, listed: ListedParam, found: ParameterValue | None = None, why: str | None = None) -> SavedParam:
        """The entry of a parameter that the drive's plugin declares: its value ``found``, or the reason ``why`` not."""
        declared = {key: getattr(listed, key) for key in _DECLARED}
        if found is None:
            return cls(**declared, unreadable=why or listed.why_not or "it was not read")
        return cls(**declared, value=found.value, unit=found.unit)

    @property
    def place(self) -> Place:
        return self.name.lower(), self.data_set, self.index

    @property
    def label(self) -> str:
        return label(self.name, self.data_set, self.index)

    @property
    def title_label(self) -> str:
        return f"{self.label} ({self.title})"

    @property
    def text(self) -> str:
        return value_text(self.value, self.unit)


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterList(SavedList[SavedParam]):
    """The parameters of one drive. ``drive``: its type; ``complete``: False after a dump that was interrupted."""

    PROGRAM = "dpstack drive"
    COMMENT = "Parameters of a drive; `dpstack drive CONFIG NAME compare FILE` shows where a drive differs."
    HEAD: ClassVar = {"drive": str, "name": str, "address": int, "time": str, "complete": bool}
    ENTRY = SavedParam

    drive: str

    @property
    def who(self) -> tuple[str, ...]:
        return self.drive, self.name

    @classmethod
    def entry(cls, plain: object, where: str) -> SavedParam:
        """The parameter of a line: name and number, and a value or the reason why it has none."""
        if isinstance(plain, Mapping) and type(plain.get("name")) is str:
            where = f"{where} ({plain['name']})"
        found = cls.check(plain, where, ("name", "number"))
        if not math.isfinite(found.get("value", 0)):
            cls.refuse(where, f"value = {found['value']!r} is of the wrong type")
        return SavedParam(**found)

    def save(self, path: str | Path) -> None:
        """Write the list atomically into a new file, or over an earlier list of the same drive. Raises UsageError."""
        with self.file(path, *self.who) as file:
            self.keep(file)


def label(name: str, data_set: int | None, index: int | None) -> str:
    """A parameter for people: ``480, data set 3``."""
    place = "" if data_set is None else f", data set {data_set}"
    return f"{name}{place}" + ("" if index is None else f", index {index}")


def value_text(value: float | int | None, unit: str) -> str:
    """A value with its unit and all its digits."""
    return f"{value!r} {unit}".rstrip()


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """A parameter read from the drive: ``value`` in ``unit``; ``raw``: the integer on the wire."""

    #: number of the parameter
    number: int
    #: name in the plugin's table; None if the table does not have the number
    name: str | None
    #: value in ``unit``
    value: float | int
    raw: int
    #: unit of ``value``; empty for a plain number
    unit: str = ""
    #: data set that was read; None if the drive has none
    data_set: int | None = None


@dataclass(frozen=True, slots=True)
class ParameterPlace:
    """A parameter by number or name, in a data set, or an element by index."""

    #: number or name
    number: int | str
    #: data set; None: the active one, or the drive has none
    data_set: int | None = None
    #: element of an array; None for a plain parameter
    index: int | None = None

    def as_dict(self) -> dict[str, int | str]:
        """The fields that have a value."""
        return {key: value for key, value in asdict(self).items() if value is not None}


class Listing(Protocol):
    """A drive with known parameters."""

    @property
    def name(self) -> str: ...

    @property
    def kind(self) -> str:
        """The name of its plugin, e.g. ``fuji-frenic``."""

    @property
    def parameters(self) -> tuple[ListedParam, ...]:
        """All declared parameters. Raises UsageError if the telegram has no parameter channel."""


class ParameterDifference(Difference[SavedParam]):
    """A parameter of a drive that differs from the file."""

    __slots__ = ()

    @property
    def is_none(self) -> bool:
        saved, found = self.saved, self.found
        if saved.value is None or found.value is None or saved.unit != found.unit:
            return False
        return is_same(saved.value, found.value)

    @property
    def text(self) -> str:
        now = self.found.text if self.found.unreadable is None else f"cannot be read: {self.found.unreadable}"
        return f"{self.saved.title_label}: file {self.saved.text}, drive {now}"


Comparison = ListComparison[ParameterDifference, SavedParam]


class Readable(Listing, Protocol):
    """A drive whose parameters can be read. Base class of the drives of this bus, and of another program's bus."""

    @property
    def address(self) -> int: ...

    @property
    def per_request(self) -> int:
        """The number of parameters in one request to the drive: several over record 47, else 1."""

    @abc.abstractmethod
    async def read_many(
        self, parameters: Sequence[ParameterPlace], *, timeout: float = 5.0
    ) -> list[ParameterValue | ParameterError]:
        """Read parameters; in place of one that the drive refuses is the error. Raises DriveTimeout, DriveError."""

    async def dump(
        self,
        path: str | Path | None = None,
        *,
        data_set: int | None = None,
        on_parameter: OnParameter | None = None,
    ) -> ParameterList:
        """Read all declared parameters; ``data_set`` None: of all data sets. Instead of an unreadable one, the list has
        the reason.

        ``path``: also write the list into this file, atomically, and over no file except an earlier dump of the same
        drive. If the dump is interrupted (cancelled, drive lost), the parameters read up to then go into a file with
        ``.part`` behind its name; a note of the error names it. Raises UsageError, DriveError.
        """
        wanted = _chosen(self, data_set)
        found: list[SavedParam] = []
        reading = _Reading(self, wanted, found, on_parameter)
        if path is None:
            await reading.read_all()
            return _list_of(self, found, complete=True)
        with ParameterList.file(path, self.kind, self.name) as file:
            try:
                await reading.read_all()
            except BaseException as error:
                if found:
                    error.add_note(_kept(file, _list_of(self, found, complete=False)))
                raise
            whole = _list_of(self, found, complete=True)
            whole.keep(file)
            return whole

    async def compare(
        self,
        saved: ParameterList | str | Path,
        *,
        data_set: int | None = None,
        read_only: bool = False,
        on_parameter: OnParameter | None = None,
    ) -> Comparison:
        """Read the drive's parameters that are in ``saved`` (a list, or a file), and return the differences.

        ``read_only``: compare read-only parameters (actual values, properties), too. Raises ConfigError for a file of
        another type of drive and for a value between two steps of its parameter, UsageError, DriveError.
        """
        listed = saved if isinstance(saved, ParameterList) else ParameterList.load(saved)
        wanted, skipped = _compared(self, listed, "the list" if listed is saved else str(saved), data_set, read_only)
        found: list[SavedParam] = []
        await _Reading(self, [there for _, there in wanted], found, on_parameter).read_all()
        pairs = [ParameterDifference(old, new) for (old, _), new in zip(wanted, found, strict=True)]
        return ListComparison.of(pairs, skipped)


def _kept(file: AtomicFile, part: ParameterList) -> str:
    """Write ``part`` of a list into ``file``. Returns a note about it, also if that fails."""
    read = f"cut short: the {len(part.parameters)} parameters read so far are"
    try:
        return f"{read} in {part.keep(file)}"
    except UsageError as failed:
        return f"{read} lost: {failed}"


def check_dump(drive: Listing, path: str | Path, *, data_set: int | None = None) -> None:
    """Raises the errors of :meth:`Readable.dump` before it reads anything."""
    _chosen(drive, data_set)
    with ParameterList.file(path, drive.kind, drive.name):
        pass


def check_compare(drive: Listing, path: str | Path, *, data_set: int | None = None, read_only: bool = False) -> None:
    """Raises the errors of :meth:`Readable.compare` before it reads anything."""
    _compared(drive, ParameterList.load(path), str(path), data_set, read_only)


def _compared(
    drive: Listing, listed: ParameterList, where: str, data_set: int | None, read_only: bool
) -> tuple[list[tuple[SavedParam, ListedParam]], list[tuple[SavedParam, str]]]:
    """The pairs to compare, and all other entries, each with the reason. Raises as :meth:`Readable.compare`."""
    if listed.drive != drive.kind:
        raise ConfigError(
            f"{where} holds the parameters of a {listed.drive} ({listed.name}), {drive.name} is a {drive.kind}: "
            f"take a file of such a drive"
        )
    there = {SavedParam.of(one).place: one for one in _chosen(drive, data_set)}
    meant = (one for one in listed.parameters if data_set is None or one.data_set in (None, data_set))
    wanted, skipped = pairs_of(meant, there, SavedParam.of, missing="the plugin does not know it", read_only=read_only)
    for one, listed_there in wanted:
        _check_step(one, listed_there, where)
    return wanted, skipped


def _chosen(drive: Listing, data_set: int | None) -> list[ListedParam]:
    """The parameters to read. Raises UsageError for a data set that the drive does not have."""
    listed = drive.parameters
    sets = sorted({one.data_set for one in listed if one.data_set is not None})
    if data_set is not None and data_set not in sets:
        there = f"{sets[0]}..{sets[-1]}" if sets else "none"
        raise UsageError(f"drive {drive.name}: a {drive.kind} has no data set {data_set}; it has {there}")
    if not listed:
        raise UsageError(f"drive {drive.name}: the plugin {drive.kind} declares no parameters; read them by number")
    return [one for one in listed if data_set is None or one.data_set in (None, data_set)]


@dataclass(slots=True)
class _Reading:
    """Reads the parameters ``wanted`` into the list ``found``; of a refused one it keeps the reason. Raises DriveError
    for a lost drive."""

    drive: Readable
    wanted: Sequence[ListedParam]
    found: list[SavedParam]
    on_parameter: OnParameter | None
    #: number of parameters without an answer, one after the other
    silent: int = 0

    async def read_all(self) -> None:
        size = max(self.drive.per_request, 1)
        for at in range(0, len(self.wanted), size):
            await self._read(self.wanted[at : at + size])

    async def _read(self, some: Sequence[ListedParam]) -> None:
        """Read ``some`` by one request; after a time-out by one request each: a single parameter may be the cause."""
        places = [ParameterPlace(one.name, one.data_set, one.index) for one in some if one.why_not is None]
        answers: list[ParameterValue | DriveError] = []
        try:
            answers += await self.drive.read_many(places) if places else ()
        except DriveTimeout as error:
            if len(places) > 1:
                for one in some:
                    await self._read([one])
                return
            answers.append(error)
        remaining = iter(answers)
        for one in some:
            self._keep(one, None if one.why_not is not None else next(remaining))

    def _keep(self, one: ListedParam, answer: ParameterValue | DriveError | None) -> None:
        self.silent = self.silent + 1 if isinstance(answer, DriveTimeout) else 0
        if isinstance(answer, DriveTimeout) and self.silent == _SILENT:
            raise answer
        if isinstance(answer, DriveError):
            self.found.append(SavedParam.of(one, why=str(answer).removeprefix(f"drive {self.drive.name}: ")))
        else:
            self.found.append(SavedParam.of(one, answer))
        if self.on_parameter is not None:
            self.on_parameter(len(self.found), len(self.wanted), self.found[-1])


def _check_step(saved: SavedParam, there: ListedParam, where: str) -> None:
    """Raises ConfigError if the value lies between two steps of the parameter: no drive can ever be equal to it."""
    if saved.value is None or saved.unit != there.unit or not there.per_unit:
        return
    try:
        count_of(saved.label, saved.value, there.per_unit, there.unit)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}; correct the line") from None


def _list_of(drive: Readable, found: Sequence[SavedParam], *, complete: bool) -> ParameterList:
    return ParameterList(
        drive=drive.kind,
        name=drive.name,
        address=drive.address,
        time=time_now(),
        parameters=tuple(found),
        complete=complete,
    )
