"""The parameters of the simulated F5 as its operator reads and writes them
(docs/reference/drives/keb-f5.md#indexes)."""

from __future__ import annotations

from collections.abc import Callable

from msgspec import Struct

from dpstack.profile import ParamSpec, ParamStore
from dpstack_drives.keb import table as t
from dpstack_drives.keb.channel import RefusedError
from dpstack_drives.keb.pdmap import MapField

#: parameters that process data write: never stored
_PASSWORD, _PASSWORD_INDEX = 440, 0x2801


class Parameters(Struct, eq=False):
    """``live`` gives actual values, None for what is stored; ``refusal``: the error that an access (``write`` or not)
    ends with by an order from outside.

    Readings: writes need the password of the recipe; a parameter that exists once is in set 0; subindex 0 is set 0.
    """

    store: ParamStore
    _live: Callable[[int], int | None]
    _refusal: Callable[..., int | None]
    #: the link to the inverter (HSP5) stands
    linked: bool = True

    def raw(self, index: int) -> int:
        """The integer stored in set 0."""
        spec = t.PARAMETERS.get(index)
        return 0 if spec is None else self.store.raw(spec)

    def provides(self, entry: MapField) -> bool:
        spec = t.PARAMETERS.get(entry.key)
        return spec is not None and spec.type.wide == (entry.octets == 4)

    def fetch(self, entry: MapField) -> int:
        """The value for the operator; of sets with different values the first one (a reading)."""
        spec = t.PARAMETERS.get(entry.key)
        if spec is None:
            return 0
        live = self._live(entry.key)
        first = (entry.sets & -entry.sets).bit_length()
        return self.store.raw(spec, first) if live is None else live

    def store_output(self, entry: MapField, raw: int) -> None:
        spec = t.PARAMETERS.get(entry.key)
        if spec is not None and spec.write_error(value := spec.from_pwe(raw)) is None:
            self._write(spec, value, entry.sets, ram_only=True)

    def _write(self, spec: ParamSpec, raw: int, sets: int, *, ram_only: bool) -> None:
        if spec.number == t.CONTROL_LONG:
            control = t.PARAMETERS.get(t.CONTROL_WORD)
            assert control is not None
            self.store.write(control, raw & 0xFFFF, ram_only=True)
        for number in range(t.SETS):
            if sets >> number & 1:
                self.store.write(spec, raw, number + 1, ram_only=ram_only)
                if not spec.per_set:
                    return

    def request(self, index: int, subindex: int, raw: int | None, octets: int) -> tuple[int, int]:
        """An access of the parameter channel: the value and its octets. Raises RefusedError."""
        if index in t.INVERTER:
            if not self.linked:
                raise RefusedError(t.NO_INVERTER)
            number = self._refusal(write=raw is not None)
            if number is not None:
                raise RefusedError(t.Code.of(number))
        spec = t.PARAMETERS.get(index)
        if spec is None:
            raise RefusedError(t.BAD_INDEX)
        sets = self._sets(spec, subindex)
        if raw is not None:
            self._change(spec, sets, raw, octets)
            return raw, octets
        return self._read(spec, sets), 4 if spec.type.wide else 2

    def _sets(self, spec: ParamSpec, subindex: int) -> int:
        """The sets meant; 0 is the one that Fr.09 points to, set 0 here."""
        if spec.number in t.INTERFACE:
            if subindex:
                raise RefusedError(t.BAD_SUBINDEX)
            return 1
        if not spec.per_set and subindex > 1:
            raise RefusedError(t.BAD_SET)
        return subindex or 1

    def _change(self, spec: ParamSpec, sets: int, raw: int, octets: int) -> None:
        if spec.read_only:
            raise RefusedError(t.WRITE_PROTECTED)
        if self.store.value("ud.01") != _PASSWORD and spec.number in t.INVERTER and spec.number != _PASSWORD_INDEX:
            raise RefusedError(t.PASSWORD)
        value = spec.from_wire(raw, 8 * octets)
        if spec.write_error(value) is not None:
            raise RefusedError(t.BAD_VALUE)
        self._write(spec, value, sets, ram_only=spec.volatile)

    def _read(self, spec: ParamSpec, sets: int) -> int:
        live = self._live(spec.number)
        if live is not None:
            return live & 0xFFFF_FFFF
        values = {self.store.raw(spec, n + 1) for n in range(t.SETS) if sets >> n & 1}
        if len(values) > 1:
            raise RefusedError(t.NOT_POSSIBLE)
        return values.pop() & 0xFFFF_FFFF
