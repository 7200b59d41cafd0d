"""The parameter channel of the F5 operator (docs/reference/drives/keb-f5.md#administration-byte): indexes, sets, scales
and errors; the handshake is that of every channel with 16-bit indexes.

Every access is made with 4 octets.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.profile import (
    CommandError,
    CycleTimes,
    FindSpec,
    IndexedChannel,
    IndexedDialect,
    IndexedServer,
    ParamKey,
    ParamRef,
    ParamSpec,
    RefusedAccess,
    count_of,
)
from dpstack_drives.keb import table as t

DIALECT: Final = IndexedDialect(
    errors={code.number: text for code, text in t.ERRORS.items()}, busy=frozenset({t.BUSY.number}), services=0x03
)


def target(index: int, subindex: int, label: str, data_set: int | None = None) -> ParamRef:
    """A parameter as it stands in the channel, and what to call it."""
    return ParamRef(index, subindex, False, None, label, data_set)


def scale_of(index: int) -> tuple[int, str]:
    """Counts per unit, and the unit, if the manual shows them."""
    return t.SCALES.get(index, (1, ""))


def _count(label: str, value: float, scale: float, unit: str) -> int:
    """The integer on the wire. Raises CommandError if the value lies between two."""
    try:
        return count_of(label, value, scale, unit)
    except ValueError as error:
        raise CommandError("usage", str(error)) from None


def find(key: ParamKey) -> ParamRef:
    """The parameter a user named. Raises CommandError of kind usage.

    ``data_set`` 0..7 becomes its bit of the subindex; ``index`` is the subindex itself (0 = indirect, several bits =
    several sets). Neither: set 0, of the operator's own parameters subindex 0.
    """
    if key.ram:
        raise CommandError("usage", "keb-f5 has no writes to RAM only (F5-C: ud.05 says when it stores)")
    index = _index(key.name)
    if not t.INVERTER.start <= index <= 0xFFFF:
        raise CommandError(
            "usage", f"index {index:04X}h: inverter parameters begin at 2000h (2000h + the address in its manual)"
        )
    spec = t.PARAMETERS.get(index) if t.index_of(str(key.name)) is not None else None
    label = t.name_of(index) + (f" {spec.title}" if spec is not None else "")
    if key.data_set is not None and key.index is not None:
        raise CommandError("usage", f"{label}: give data_set or index (the subindex), not both")
    if key.index is not None:
        if key.index > 0xFF:
            raise CommandError("usage", f"{label}: subindexes are 0..255")
        return target(index, key.index, label)
    if index not in t.INVERTER:
        if key.data_set is not None:
            raise CommandError("usage", f"{label} has no sets; give the subindex as index")
        return target(index, 0, label)
    data_set = key.data_set or 0
    if data_set >= t.SETS:
        raise CommandError("usage", f"{label}: sets are 0..{t.SETS - 1}")
    return target(index, 1 << data_set, label, data_set)


def _index(name: str | int) -> int:
    if isinstance(name, int):
        return name
    found = t.index_of(name)
    if found is not None:
        return found
    if t.looks_like_name(name):
        raise CommandError(
            "usage",
            f"{name!r}: the address of its group is not in the manual (of {', '.join(t.GROUPS)} it is): give the "
            "index, 0x2000 + the address in the application manual",
        )
    try:
        return int(name.removesuffix("h"), 16)
    except ValueError:
        raise CommandError("usage", f"{name!r} is neither a parameter such as oP.3 nor an index in hex") from None


class KebChannel(IndexedChannel):
    """The master's end."""

    def __init__(self, times: CycleTimes) -> None:
        super().__init__(DIALECT, times, find)

    def described(self, index: int, subindex: int, find: FindSpec) -> tuple[str, ParamSpec | None]:
        return t.name_of(index), None

    def to_raw(self, ref: ParamRef, value: float) -> int:
        """The integer on the wire if the manual shows no scale."""
        scale, unit = scale_of(ref.pnu)
        raw = int(value) if scale == 1 else _count(ref.label, value, scale, unit)
        if (scale == 1 and raw != value) or not -(1 << 31) <= raw < 1 << 32:
            hint = (
                f"a number in {unit}" if unit else "the integer on the wire (32 bits): its scale is not in the manual"
            )
            raise CommandError("usage", f"{ref.label}: give {hint}")
        return raw

    def outcome(self, ref: ParamRef, raw: int) -> dict[str, object]:
        """Values are signed 32 bits."""
        scale, unit = scale_of(ref.pnu)
        found = super().outcome(ref, raw)
        signed = found["raw"]
        assert isinstance(signed, int)
        return found | {"value": signed if scale == 1 else signed / scale, "name": t.name_of(ref.pnu), "unit": unit}

    def stored_as(self, ref: ParamRef) -> ParamSpec | None:
        return t.PARAMETERS.get(ref.pnu)


class RefusedError(RefusedAccess):
    """A request that ends with an error."""

    def __init__(self, code: t.Code) -> None:
        super().__init__(code.number)


class KebServer(IndexedServer):
    """The drive's end, see :class:`IndexedServer`."""

    def __init__(self, handler: Callable[[int, int, int | None, int], tuple[int, int]]) -> None:
        super().__init__(DIALECT, handler)
