"""The OPC-E1-PDP of the simulated drive: PCV orders, PCD words, its address (docs/reference/drives/fuji.md)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.profile import DriveDevice, ParamSpec, Pkw, ReplyId, TaskId
from dpstack_drives.fuji import table as t

#: the switches stand as the station address asks for
AUTO: Final = -1


class OptionCard:
    """``live``: the present value of a PNU or an assignment, None if it is the stored one.

    Readings: the channel answers error 17 without the inverter's power; a write of a function code that is out of its
    range, or that can only be read, is ignored when it comes by PCD.
    """

    def __init__(self, device: DriveDevice, switches: int, live: Callable[[int], int | None]) -> None:
        self._device = device
        self.store = device.store
        #: SW1 and SW2, 00..99; AUTO until it is installed
        self.switches = switches
        self.address = 0
        self.baud = 0  # PNU 963
        self._live = live
        self._flag = 0  # 970
        self.writes: tuple[int, ...] = ()
        self.reads: tuple[int, ...] = ()
        self._cyclic: dict[int, int] = {}
        self.power_on()

    # -- address (2.3) --------------------------------------------------------------------------------------------

    def installed(self, address: int, baud: int | None) -> None:
        """Set up at this address: by the switches if they reach, by o31 if they are 00."""
        self.address = address
        self.baud = t.BAUD_INDEX.get(baud or 0, 0)
        if self.switches == AUTO:
            self.switches = address if 1 <= address <= t.MOST_SWITCHES else 0
        if not self.switches and self.own_address is not None:
            self.store.install("o31", address)

    @property
    def own_address(self) -> int | None:
        """From power-on; None if o31 is out of range."""
        address = self.switches or int(self.store.value("o31"))
        return address if address <= t.MOST_ADDRESS else None

    # -- PCD (8.2 (4)) --------------------------------------------------------------------------------------------

    def power_on(self) -> None:
        """The assignments count from now on; of doubled writes the lowest o code wins."""
        writes, reads = (tuple(int(self.store.value(f"o{first + n}")) for n in range(4)) for first in t.SAME.values())
        self.writes = tuple(
            0 if entry in t.READ_ONLY_HERE or entry in writes[:place] else entry for place, entry in enumerate(writes)
        )
        self.reads = reads
        self._cyclic.clear()

    def write_words(self, words: tuple[int, ...]) -> None:
        """PCD1 to PCD4 from the master: a word that changed is written, in RAM."""
        for place, raw in zip(self.writes, words, strict=False):
            if not place or self._cyclic.get(place) == raw:
                continue
            self._cyclic[place] = raw
            spec = t.spec_at(place)
            value = raw & ~t.S06_IGNORED if place == t.S06 else raw
            if spec is not None and spec.write_error(value) is None:
                self.store.write(spec, value, ram_only=True)

    def read_words(self) -> tuple[int, ...]:
        """PCD1 to PCD4 to the master."""
        return tuple(self._shown(place) for place in self.reads)

    def _shown(self, place: int) -> int:
        spec = t.spec_at(place) if place else None
        return 0 if spec is None else self._value(spec) & 0xFFFF

    # -- PCV (8.3) ------------------------------------------------------------------------------------------------

    def order(self, order: Pkw) -> tuple[int, int]:
        indexes = t.ARRAYS.get(order.pnu)
        spec = t.PARAMETERS.get(order.pnu, order.ind) or (t.PARAMETERS.get(order.pnu) if indexes else None)
        if order.id not in t.PKW.answers or spec is None:
            return ReplyId.ERROR, 0
        if not self._device.released:
            return ReplyId.ERROR, 17
        if order.id == TaskId.ELEMENTS:
            return (ReplyId.ELEMENTS, len(indexes)) if indexes else (ReplyId.ERROR, 4)
        by_index = order.id in (TaskId.READ_ARRAY, TaskId.WRITE_ARRAY_WORD)
        if indexes is None and by_index:
            return ReplyId.ERROR, 4
        if indexes is not None and (not by_index or order.ind not in indexes):
            return ReplyId.ERROR, 3
        same = self._same(order)
        reply = ReplyId.WORD if indexes is None else ReplyId.ARRAY_WORD
        if order.id in (TaskId.READ, TaskId.READ_ARRAY):
            return reply, self._value(same or spec, order.ind)
        if spec.read_only or (not self.store.value("access_permission") and spec.number != t.PNU_ACCESS):
            return ReplyId.ERROR, 1
        return self._write(same or spec, order.pwe, reply)

    def _write(self, spec: ParamSpec, pwe: int, reply: int) -> tuple[int, int]:
        raw = spec.from_pwe(pwe)
        if not spec.low <= spec.to_value(raw) <= spec.high:
            return ReplyId.ERROR, 2
        if spec.name in t.FILE.standstill and self._device.motor.on:
            return ReplyId.ERROR, 11
        if spec.number == t.PNU_INITIALISE or spec.name == "H03":
            if (self._flag and not raw) if spec.number == t.PNU_INITIALISE else raw:
                self.store.initialise()
                self.power_on()
            self._flag = raw if spec.number == t.PNU_INITIALISE else 0
        else:
            self.store.write(spec, raw & ~t.S06_IGNORED if spec.name == "S06" else raw)
        return reply, spec.pwe(raw)

    def _same(self, order: Pkw) -> ParamSpec | None:
        """The function code behind an element of 915 or 916."""
        first = t.SAME.get(order.pnu)
        return None if first is None else t.PARAMETERS.named(f"o{first + order.ind - 1}")

    def _value(self, spec: ParamSpec, ind: int = 0) -> int:
        match spec.number:
            case t.PNU_ADDRESS:
                return self.address
            case t.PNU_BAUD:
                return self.baud
            case t.PNU_INITIALISE:
                return self._flag
        live = self._live(spec.number << 8 | (spec.index or ind))
        return self.store.raw(spec) if live is None else live
