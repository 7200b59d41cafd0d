"""The simulated PROFIBUS operator: process data maps with their enables, and when data go to and from the inverter.

Passages: docs/reference/drives/keb-f5.md#process-data-map, docs/reference/drives/keb-f5.md#when-data-move.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Final

from dpstack.profile import NS_PER_MS, NS_PER_US
from dpstack_drives.keb import table as t
from dpstack_drives.keb.channel import RefusedError
from dpstack_drives.keb.parameters import Parameters
from dpstack_drives.keb.pdmap import BLOCK, DEFAULT_INPUTS, DEFAULT_OUTPUTS, SUBINDEXES, MapField, PdMap, check

#: one telegram to the inverter; how long it takes is made up
LINK_NS: Final = NS_PER_MS
#: Cyclic communication mode: the smallest cycle
_SMALLEST_CYCLE_NS: Final = 2000 * NS_PER_US
_MAX_PROCESS: Final = 2 * BLOCK
_LENGTH: Final = 1


class Direction:
    """The map of one direction: the records as written, those that power-on restores, and the map of the inverter.

    Switching off (a change of a record, of both blocks if it is the length; a bit of the enable that becomes 0) acts
    at once. Switching on acts at power-on, or if ``at_once`` is true with the enable: then the map goes to the
    inverter. ``active``: the map that the inverter has, as (octet, value) for each block; ``moving``: the values of it
    that go to or come from the inverter.
    """

    def __init__(self, default: PdMap, *, at_once: bool) -> None:
        self._at_once = at_once
        self._kept = ([dict(default.records(0)), dict(default.records(1))], [t.ENABLED, t.ENABLED])
        self.power_on()

    def map(self) -> PdMap | None:
        """As the records have it; None if they make no sense."""
        try:
            return PdMap.from_records(*self.records)
        except ValueError:
            return None

    def write(self, block: int, subindex: int, raw: int) -> None:
        """Write a subindex of a record."""
        self.records[block][subindex] = raw
        for one in (0, 1) if subindex == _LENGTH else (block,):
            self.switch_off(one)

    def switch_off(self, block: int) -> None:
        self.enable[block] = 0
        self.moving[block] = []

    def confirm(self, block: int, enable: int) -> bool:
        """The map is right: from now on it outlives power-off. Returns whether it acts at once."""
        records, enables = self._kept
        records[block] = dict(self.records[block])
        self.enable[block] = enables[block] = enable
        if self._at_once:
            self._to_inverter(block)
        else:
            self.moving[block] = _covered(enable, self.moving[block])
        return self._at_once

    def inherit(self, before: Direction, *, default: bool) -> None:
        """Switched on again; ``default``: Fb23 is 0."""
        if not default:
            self._kept = deepcopy(before._kept)
        self.power_on()

    def power_on(self) -> None:
        """Records that were not enabled are lost; the maps go to the inverter."""
        self.records, self.enable = deepcopy(self._kept)
        self.active: list[list[tuple[int, MapField]]] = [[], []]
        self.moving: list[list[tuple[int, MapField]]] = [[], []]
        for block in (0, 1):
            self._to_inverter(block)

    def _to_inverter(self, block: int) -> None:
        found = self.map()
        places = [(at, entry) for at, entry in (found.places() if found else ()) if at // BLOCK == block]
        self.active[block] = self.moving[block] = _covered(self.enable[block], places)


def _covered(enable: int, places: list[tuple[int, MapField]]) -> list[tuple[int, MapField]]:
    """The values that are switched on: bit n of the enable stands for octet n + 1 of the block."""
    return [(at, entry) for at, entry in places if not ~enable >> at % BLOCK & (1 << entry.octets) - 1]


class Operator:
    """``second``: indexes of record and enable of block 2, inputs then outputs (no manual gives them).

    ``com_cycle_us``: SelComCycle of the cyclic mode, 0 = off. ``at_once``: a map acts with its enable, not at power-on.
    Readings: in the cyclic mode all process data go with every grid; inputs that are switched off stay as they were
    read last, and are 0 after power-on and if a new map does not reach; the first outputs after the enable count as
    changed. An enable that acts at power-on is answered with 8/0/0034 whether it is confirmed or not; one that acts at
    once is confirmed, or answered with 6/5/0000.
    """

    def __init__(
        self,
        inverter: Parameters,
        second: tuple[tuple[int, int], tuple[int, int]],
        com_cycle_us: float,
        *,
        at_once: bool,
    ) -> None:
        self._inverter = inverter
        self._com_cycle_ns = round(com_cycle_us * NS_PER_US)
        self._at_once = at_once
        self.into = Direction(DEFAULT_INPUTS, at_once=at_once)
        self.out = Direction(DEFAULT_OUTPUTS, at_once=at_once)
        (in_record, in_enable), (out_record, out_enable) = second
        places = ((self.into, 0), (self.out, 0), (self.into, 1), (self.out, 1))
        records = (t.MAP_INPUTS, t.MAP_OUTPUTS, in_record, out_record)
        enables = (t.ENABLE_INPUTS, t.ENABLE_OUTPUTS, in_enable, out_enable)
        self._records = dict(zip(records, places, strict=True))
        self._enables = dict(zip(enables, places, strict=True))
        #: telegrams with outputs that went to the inverter
        self.output_telegrams = 0
        self._sent: list[bytes | None] = [None, None]
        self._image = bytearray(_MAX_PROCESS)
        self._due = 0
        self._second_next = False

    def inherit(self, before: Operator, *, default: bool) -> None:
        self.into.inherit(before.into, default=default)
        self.out.inherit(before.out, default=default)

    # -- parameters of its own ------------------------------------------------------------------------------------

    def access(self, index: int, subindex: int, raw: int | None) -> int | None:
        """Read (``raw`` None) or write a record or an enable; None if the index is neither. Raises RefusedError."""
        if index in self._records:
            direction, block = self._records[index]
            return self._record(direction, block, subindex, raw)
        if index in self._enables:
            direction, block = self._enables[index]
            if subindex:
                raise RefusedError(t.BAD_SUBINDEX)
            return self._enable(direction, block, raw)
        return None

    def _record(self, direction: Direction, block: int, subindex: int, raw: int | None) -> int:
        first = _LENGTH if block == 0 else _LENGTH + 1
        if not first <= subindex <= SUBINDEXES:
            raise RefusedError(t.BAD_SUBINDEX)
        if raw is None:
            return direction.records[block][subindex]
        if raw > (_MAX_PROCESS if subindex == _LENGTH else 0xFFFF):
            raise RefusedError(t.BAD_MAP)
        direction.write(block, subindex, raw)
        return raw

    def _enable(self, direction: Direction, block: int, raw: int | None) -> int:
        if raw is None:
            return direction.enable[block]
        if raw > t.ENABLED:
            raise RefusedError(t.BAD_VALUE)
        if raw == 0:
            direction.switch_off(block)
            return 0
        if not self._right(direction):
            direction.switch_off(block)
            raise RefusedError(t.BAD_MAP if self._at_once else t.NOT_POSSIBLE)
        if not direction.confirm(block, raw):
            raise RefusedError(t.NOT_POSSIBLE)
        if direction is self.out:
            self._sent[block] = None
        else:
            self._image[block * BLOCK : (block + 1) * BLOCK] = bytes(BLOCK)
        return raw

    def _right(self, direction: Direction) -> bool:
        into, out = self.into.map(), self.out.map()
        if into is None or out is None or check(into, out) is not None:
            return False
        return all(self._inverter.provides(entry) for entry in (into if direction is self.into else out).fields)

    def shown(self, index: int) -> int | None:
        """The map that the inverter has, as it shows it in sy.16 to sy.31 and sy.58 to sy.73; None for any other index.

        The sets of a value that is off are set 0 for inputs and all of them for outputs, as in the manual's table.
        """
        for direction, firsts, sets in ((self.into, t.ACTIVE_INPUTS, 1), (self.out, t.ACTIVE_OUTPUTS, 0xFF)):
            for block, first in enumerate(firsts):
                value, of_sets = divmod(index - first, 2)
                if 0 <= value < t.BLOCK_VALUES:
                    entries = [entry for _, entry in direction.active[block]]
                    if value >= len(entries):
                        return sets if of_sets else -1
                    return entries[value].sets if of_sets else entries[value].key - t.INVERTER.start
        return None

    # -- process data ---------------------------------------------------------------------------------------------

    def write_outputs(self, process: bytes, now: int) -> None:
        """Outputs as received: a block goes to the inverter when it has changed, one telegram a scan.

        In the cyclic mode every block goes at each point of the grid.
        """
        blocks = [process[:BLOCK], process[BLOCK:_MAX_PROCESS]]
        grid = self._com_cycle_ns > 0
        if grid and now < self._due:
            return
        for number, octets in enumerate(blocks):
            entries = [(at, entry) for at, entry in self.out.moving[number] if at + entry.octets <= len(process)]
            if entries and (grid or octets != self._sent[number]):
                self._sent[number] = octets
                self.output_telegrams += 1
                for at, entry in entries:
                    self._inverter.store_output(entry, int.from_bytes(process[at : at + entry.octets], "big"))
                if not grid:
                    return

    def read_inputs(self, length: int, now: int) -> bytes:
        """Inputs of ``length`` octets as they stand now."""
        if self._second_next:
            self._second_next = False
            self._read(1)
        elif now >= self._due:
            self._read(0)
            if self._com_cycle_ns:
                self._read(1)
                self._due = now + max(_SMALLEST_CYCLE_NS, self._com_cycle_ns)
            else:
                self._second_next = bool(self.into.active[1])
                self._due = now + max(
                    int(self._inverter.store.value("Fb.09")) * NS_PER_MS, LINK_NS * (2 if self._second_next else 1)
                )
        return self.last_inputs(length)

    def last_inputs(self, length: int) -> bytes:
        """Inputs as they were read last."""
        return bytes(self._image[:length]).ljust(length, b"\0")

    def _read(self, block: int) -> None:
        for at, entry in self.into.moving[block]:
            raw = self._inverter.fetch(entry)
            self._image[at : at + entry.octets] = (raw & (1 << 8 * entry.octets) - 1).to_bytes(entry.octets, "big")
