"""Reading all parameters of a drive, into a file and against a file; the cyclic data go on meanwhile."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final, Protocol

from dpstack.api.files import FileToBe
from dpstack.api.lists.list_file import ListComparison, is_same, pairs_of, time_now
from dpstack.api.lists.parameter_list import ParameterList, Place, SavedParam
from dpstack.errors import ConfigError, DriveError, DriveTimeout, ParameterError, UsageError
from dpstack.profile import ListedParam, count_of

#: so many in a row that are not answered: the others will not be either
_SILENT: Final = 3

#: called after each parameter: how many are read, of how many, the last one
OnParameter = Callable[[int, int, SavedParam], None]


@dataclass(frozen=True, slots=True)
class ParameterValue:
    """One parameter as the drive tells it: ``value`` in ``unit``, ``raw`` the integer on the wire."""

    number: int
    name: str | None
    value: float | int
    raw: int
    unit: str = ""
    data_set: int | None = None


@dataclass(frozen=True, slots=True)
class ParameterPlace:
    """A parameter by number or name, in a data set, or an element by index."""

    number: int | str
    data_set: int | None = None
    index: int | None = None

    def as_dict(self) -> dict[str, int | str]:
        """What is given of it."""
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
        """All that is to be read. Raises UsageError where the telegram has no parameter channel."""


class Readable(Listing, Protocol):
    """A drive whose parameters can be read: of this bus, or of another program's."""

    @property
    def address(self) -> int: ...

    @property
    def per_request(self) -> int:
        """How many of them one request to the drive carries."""

    async def read_many(
        self, parameters: Sequence[ParameterPlace], *, timeout: float = 5.0
    ) -> list[ParameterValue | ParameterError]:
        """Some of them; what the drive refuses is the error in its place. Raises DriveTimeout, DriveError."""


@dataclass(frozen=True, slots=True)
class Difference:
    """A parameter that differs from the file: ``found`` has the drive's value, or why it cannot be read."""

    saved: SavedParam
    found: SavedParam

    @property
    def text(self) -> str:
        """One line for people: both values with their units."""
        now = self.found.text if self.found.unreadable is None else f"cannot be read: {self.found.unreadable}"
        return f"{self.saved.title_label}: file {self.saved.text}, drive {now}"


Comparison = ListComparison[Difference, SavedParam]


async def dump(
    drive: Readable,
    path: str | Path | None = None,
    *,
    data_set: int | None = None,
    on_parameter: OnParameter | None = None,
) -> ParameterList:
    """Read the drive's parameters, as many by a request as it carries; ``data_set`` None: of all data sets.

    With ``path`` into that file, whole or not at all; cut short (cancelled, the drive lost) what was read is kept in
    a file of that name with ``.part`` behind it, which the error has as a note. An earlier dump of the same drive is
    replaced, no other file is. Raises UsageError, DriveError.
    """
    wanted = _chosen(drive, data_set)
    found: list[SavedParam] = []
    if path is None:
        await _read_all(drive, wanted, found, on_parameter)
        return _list_of(drive, found, complete=True)
    with ParameterList.file(path, drive.kind, drive.name) as file:
        try:
            await _read_all(drive, wanted, found, on_parameter)
        except BaseException as error:
            if found:
                error.add_note(_kept(file, _list_of(drive, found, complete=False)))
            raise
        whole = _list_of(drive, found, complete=True)
        whole.keep(file)
        return whole


def _kept(file: FileToBe, part: ParameterList) -> str:
    """Where the ``part`` is of a list that was cut short. What cut it short is told, not that there is no room, too."""
    read = f"cut short: the {len(part.parameters)} parameters read so far are"
    try:
        return f"{read} in {part.keep(file)}"
    except UsageError as failed:
        return f"{read} lost: {failed}"


async def compare(
    drive: Readable,
    saved: ParameterList | str | Path,
    *,
    data_set: int | None = None,
    read_only: bool = False,
    on_parameter: OnParameter | None = None,
) -> Comparison:
    """Read the drive's parameters that are in ``saved`` (a list, or a file) and tell where they differ.

    Read-only parameters (actual values, properties) are compared only with ``read_only``. Raises ConfigError
    for a file of another type of drive and for a value between two steps of its parameter, UsageError, DriveError.
    """
    listed = saved if isinstance(saved, ParameterList) else ParameterList.load(saved)
    wanted, skipped = _compared(drive, listed, "the list" if listed is saved else str(saved), data_set, read_only)
    found: list[SavedParam] = []
    await _read_all(drive, [there for _, there in wanted], found, on_parameter)
    pairs = [Difference(old, new) for (old, _), new in zip(wanted, found, strict=True)]
    differences = tuple(pair for pair in pairs if not _equal(pair.saved, pair.found))
    return ListComparison(differences, len(pairs) - len(differences), tuple(skipped))


def check_dump(drive: Listing, path: str | Path, *, data_set: int | None = None) -> None:
    """Raises what :func:`dump` raises before it reads anything."""
    _chosen(drive, data_set)
    with ParameterList.file(path, drive.kind, drive.name):
        pass


def check_compare(drive: Listing, path: str | Path, *, data_set: int | None = None, read_only: bool = False) -> None:
    """Raises what :func:`compare` raises before it reads anything."""
    _compared(drive, ParameterList.load(path), str(path), data_set, read_only)


def _compared(
    drive: Listing, listed: ParameterList, where: str, data_set: int | None, read_only: bool
) -> tuple[list[tuple[SavedParam, ListedParam]], list[tuple[SavedParam, str]]]:
    """The pairs to be compared, and the others with the reason. Raises as :func:`compare`."""
    if listed.drive != drive.kind:
        raise ConfigError(
            f"{where} holds the parameters of a {listed.drive} ({listed.name}), {drive.name} is a {drive.kind}: "
            f"take a file of such a drive"
        )
    there = {_place(one): one for one in _chosen(drive, data_set)}
    meant = (one for one in listed.parameters if data_set is None or one.data_set in (None, data_set))
    wanted, skipped = pairs_of(meant, there, _saved, missing="the plugin does not know it", read_only=read_only)
    for one, listed_there in wanted:
        _held(one, listed_there, where)
    return wanted, skipped


def _chosen(drive: Listing, data_set: int | None) -> list[ListedParam]:
    """What is to be read. Raises UsageError for a data set that the drive does not have."""
    listed = drive.parameters
    sets = sorted({one.data_set for one in listed if one.data_set is not None})
    if data_set is not None and data_set not in sets:
        there = f"{sets[0]}..{sets[-1]}" if sets else "none"
        raise UsageError(f"drive {drive.name}: a {drive.kind} has no data set {data_set}; it has {there}")
    if not listed:
        raise UsageError(f"drive {drive.name}: the plugin {drive.kind} declares no parameters; read them by number")
    return [one for one in listed if data_set is None or one.data_set in (None, data_set)]


async def _read_all(
    drive: Readable, wanted: Sequence[ListedParam], found: list[SavedParam], on_parameter: OnParameter | None
) -> None:
    """Fill ``found``, in their order. What the drive refuses goes in with its reason; a lost drive raises."""
    reading = _Reading(drive, len(wanted), found, on_parameter)
    size = max(drive.per_request, 1)
    for at in range(0, len(wanted), size):
        await reading.read(wanted[at : at + size])


@dataclass(slots=True)
class _Reading:
    drive: Readable
    count: int
    found: list[SavedParam]
    on_parameter: OnParameter | None
    silent: int = 0

    async def read(self, some: Sequence[ListedParam]) -> None:
        """By one request; where it has no answer, by one each: one parameter may be the reason."""
        places = [ParameterPlace(one.name, one.data_set, one.index) for one in some if one.why_not is None]
        answers: list[ParameterValue | DriveError] = []
        try:
            answers += await self.drive.read_many(places) if places else ()
        except DriveTimeout as error:
            if len(places) > 1:
                for one in some:
                    await self.read([one])
                return
            answers.append(error)
        told = iter(answers)
        for one in some:
            self._take(one, None if one.why_not is not None else next(told))

    def _take(self, one: ListedParam, told: ParameterValue | DriveError | None) -> None:
        self.silent = self.silent + 1 if isinstance(told, DriveTimeout) else 0
        if isinstance(told, DriveTimeout) and self.silent == _SILENT:
            raise told
        if isinstance(told, DriveError):
            self.found.append(_saved(one, why=str(told).removeprefix(f"drive {self.drive.name}: ")))
        else:
            self.found.append(_saved(one, told))
        if self.on_parameter is not None:
            self.on_parameter(len(self.found), self.count, self.found[-1])


def _saved(one: ListedParam, told: ParameterValue | None = None, why: str | None = None) -> SavedParam:
    return SavedParam(
        name=one.name,
        number=one.number,
        title=one.title,
        subindex=one.subindex,
        data_set=one.data_set,
        index=one.index,
        value=None if told is None else told.value,
        unit="" if told is None else told.unit,
        read_only=one.read_only,
        unreadable=(why or one.why_not or "it was not read") if told is None else None,
    )


def _place(one: ListedParam) -> Place:
    return one.name.lower(), one.data_set, one.index


def _held(saved: SavedParam, there: ListedParam, where: str) -> None:
    """Raises ConfigError where the value lies between two that the drive can hold: no drive is ever equal to it."""
    if saved.value is None or saved.unit != there.unit or not there.per_unit:
        return
    try:
        count_of(saved.label, saved.value, there.per_unit, there.unit)
    except ValueError as error:
        raise ConfigError(f"{where}: {error}; correct the line") from None


def _equal(old: SavedParam, new: SavedParam) -> bool:
    if old.value is None or new.value is None or old.unit != new.unit:
        return False
    return is_same(old.value, new.value)


def _list_of(drive: Readable, found: Sequence[SavedParam], *, complete: bool) -> ParameterList:
    return ParameterList(
        drive=drive.kind,
        name=drive.name,
        address=drive.address,
        time=time_now(),
        parameters=tuple(found),
        complete=complete,
    )
