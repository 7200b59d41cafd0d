"""Names and numbers of parameters, as the parameter channel has them
(docs/reference/drives/ls-s100.md#parameter-channel)."""

from __future__ import annotations

from typing import Final

from dpstack.profile import CommandError, ParamKey, ParamRef, ParamSpec, listing
from dpstack_drives.ls import table as t


def _why_not(spec: ParamSpec) -> str | None:
    """A dump leaves alone what is not to be used beside a drive profile; only telegrams with one have a channel."""
    if (spec.number << 8 | spec.index) not in t.ADVISED_AGAINST:
        return None
    return "the manual advises against it beside a drive profile (5.1, 5.3); read it by itself where you must"


#: codes and PNUs, arrays element by element
LISTED: Final = listing(
    t.PARAMETERS, elements={number: range(size) for number, size in t.ARRAYS.items()}, why_not=_why_not
)


def resolve(key: ParamKey, drive: str) -> tuple[ParamRef, int | None]:
    """The reference and, for a drive parameter, its address. Raises CommandError.

    A number is a PNU if it is one of the module's (chapter 7), otherwise an address; ``0x03C5`` is always one.
    """
    name, index = key.name, key.place
    if key.ram:
        raise CommandError("usage", f"{drive} has no writes to RAM only")
    where = t.address(name) if isinstance(name, str) else None
    if where is None:
        spec = t.PARAMETERS.named(name) if isinstance(name, str) else t.PARAMETERS.get(name)
        if spec is not None and not spec.index:
            return _pnu(spec.number, index), None
        if spec is not None:  # an address without 0x, as the manual's tables have it
            where = spec.number << 8 | spec.index
        elif isinstance(name, str):
            raise CommandError("usage", f"{name!r} is neither a code such as dr-03 nor a known name nor an address")
        else:
            where = name
    if not 0 < where <= 0xFFFF:
        raise CommandError("usage", f"parameter {where}: addresses are 1..65535")
    if index is not None:
        raise CommandError("usage", f"{t.code_of(where)} has no index")
    spec = t.spec_at(where)
    return ParamRef(where >> 8, where & 0xFF, False, spec, spec.label if spec else t.code_of(where)), where


def _pnu(number: int, index: int | None) -> ParamRef:
    size = t.ARRAYS.get(number)
    if index is not None and not 0 <= index < (size or 0):
        limits = f"indexes are 0..{size - 1}" if size else "it has no index"
        raise CommandError("usage", f"PNU {number}: {limits}")
    label = f"PNU {number}" + (f"[{index}]" if index is not None else "")
    return ParamRef(number, index or 0, size is not None, t.PARAMETERS.get(number), label)
