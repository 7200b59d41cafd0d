"""The parameters of a simulated drive: RAM and EEPROM values, data sets, a count of EEPROM writes."""

from __future__ import annotations

from collections.abc import Mapping

from dpstack.errors import ConfigError
from dpstack.profile.model.drive_type import config_number
from dpstack.profile.model.params import ParamSpec, ParamTable


class ParamStore:
    """Values as the integers on the wire. ``sets`` data sets, numbered from 1; a plain parameter has one value.

    Construction takes presets by name or number in engineering units. Raises ConfigError.
    """

    __slots__ = ("_eeprom", "_ram", "_values", "changes", "eeprom_writes", "sets", "table")

    def __init__(
        self, table: ParamTable, presets: Mapping[str, object], *, sets: int = 1, where: str = "drive"
    ) -> None:
        #: the parameters
        self.table = table
        #: number of data sets, counted from 1
        self.sets = sets
        #: writes that the EEPROM had to store
        self.eeprom_writes = 0
        #: counts the occasions at which values may have changed
        self.changes = 0
        self._values: dict[tuple[str, int], float] = {}  # cache of value() since the last write
        self._ram: dict[str, list[int]] = {}
        for spec in table:
            if not spec.text:
                self._ram[spec.name] = [spec.to_raw(spec.factory)] * (sets if spec.per_set else 1)
        for name, value in presets.items():
            self._preset(name, value, where)
        self._eeprom = {name: list(values) for name, values in self._ram.items()}

    def _preset(self, name: str, value: object, where: str) -> None:
        spec = self.table.named(name)
        if spec is None or spec.text:
            raise ConfigError(f"{where}: there is no option or parameter {name!r}{self.table.hint(name)}")
        number = config_number(f"{where}: parameter {spec.label}", value)
        try:
            raw = spec.to_raw(number)
        except ValueError as error:
            raise ConfigError(f"{where}: parameter {error}") from None
        self._ram[spec.name] = [raw] * len(self._ram[spec.name])

    def raw(self, spec: ParamSpec, data_set: int = 1) -> int:
        """The integer of ``spec`` in a data set (ignored for a plain parameter)."""
        values = self._ram[spec.name]
        return values[data_set - 1 if len(values) > 1 else 0]

    def value(self, name: str, data_set: int = 1) -> float:
        """The value of the parameter called ``name`` in its unit."""
        known = self._values.get((name, data_set))
        if known is not None:
            return known
        spec = self.table.named(name)
        if spec is None:
            raise KeyError(name)
        value = self._values[name, data_set] = spec.to_value(self.raw(spec, data_set))
        return value

    def unequal(self, spec: ParamSpec) -> bool:
        """Whether the data sets hold different values."""
        return len(set(self._ram[spec.name])) > 1

    def write(self, spec: ParamSpec, raw: int, data_set: int = 0, *, ram_only: bool = False) -> None:
        """Set the value in ``data_set``, 0 for all of them; an EEPROM write is counted once for each set."""
        self._changed()
        stores = [self._ram[spec.name]] if ram_only else [self._ram[spec.name], self._eeprom[spec.name]]
        count = len(stores[0])
        places = range(count) if data_set == 0 or count == 1 else (data_set - 1,)
        for place in places:
            for values in stores:
                values[place] = raw
            self.eeprom_writes += not ram_only

    def install(self, name: str, value: float) -> None:
        """Set a value at commissioning, in RAM and EEPROM, without counting; ignored outside the limits."""
        spec = self.table.named(name)
        if spec is not None and spec.low <= value <= spec.high:
            self._changed()
            for stores in (self._ram, self._eeprom):
                stores[spec.name] = [spec.to_raw(value)] * len(stores[spec.name])

    def initialise(self) -> None:
        """All factory values, in RAM and EEPROM."""
        for spec in self.table:
            if not spec.text:
                self.write(spec, spec.to_raw(spec.factory))

    def inherit(self, before: ParamStore) -> None:
        """Take over EEPROM and count of writes of ``before``, the same drive before it was switched off and on."""
        self._eeprom = {name: list(values) for name, values in before._eeprom.items()}
        self.eeprom_writes = before.eeprom_writes
        self.power_up()

    def power_up(self) -> None:
        """RAM is what the EEPROM holds."""
        self._changed()
        self._ram = {name: list(values) for name, values in self._eeprom.items()}

    def _changed(self) -> None:
        self.changes += 1
        self._values.clear()
