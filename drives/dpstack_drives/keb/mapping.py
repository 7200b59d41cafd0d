"""Reading and writing the drive's process data map over the parameter channel
(docs/drives/keb-f5.md#process-data-map)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from dpstack.profile import CommandError, Steps, TelegramSpec
from dpstack_drives.keb import table as t
from dpstack_drives.keb.channel import KebChannel, Target
from dpstack_drives.keb.pdmap import BLOCK, PdMap

#: record and enable of block 1
_FIRST: Final = ((t.MAP_INPUTS, t.ENABLE_INPUTS), (t.MAP_OUTPUTS, t.ENABLE_OUTPUTS))
_NAMES: Final = ("inputs", "outputs")
#: record and enable of block 2, None where the user did not give them
Second = tuple["tuple[int, int] | None", "tuple[int, int] | None"]


class MapAccess:
    """Jobs; ``notice`` takes a line for the user. Raises CommandError."""

    def __init__(
        self, channel: KebChannel, telegram: TelegramSpec, second: Second, notice: Callable[[str], None]
    ) -> None:
        self._channel = channel
        self._telegram = telegram
        self._second = second
        self._notice = notice

    def read(self, deadline: int) -> Steps[dict[str, object]]:
        """Both maps as the drive's records have them, and their enables."""
        value: dict[str, object] = {}
        for number, name in enumerate(_NAMES):
            record, enable = _FIRST[number]
            length = yield from self._get(record, 1, deadline)
            blocks: list[dict[int, int]] = [{1: length}, {}]
            for block in range((length + BLOCK - 1) // BLOCK)[:2]:
                index = record if block == 0 else self._block2(number)[0]
                for subindex in range(2, 2 + 2 * min(BLOCK, length - block * BLOCK)):
                    blocks[block][subindex] = yield from self._get(index, subindex, deadline)
            try:
                value[name] = str(PdMap.from_records(*blocks))
            except ValueError as error:
                raise CommandError("parameter", f"read_map: {name}: the record ({record:04X}h) has {error}") from None
            value[f"{name}_enable"] = yield from self._get(enable, 0, deadline)
        return {"value": value}

    def write(self, inputs: PdMap, outputs: PdMap, deadline: int) -> Steps[dict[str, object]]:
        """Write both records (checked before), enable them, and see whether the drive confirms the enable.

        The enable is answered by an error that tells it acts after power-on; which one is not in the manual, so any
        that is not about the access itself is taken for it, and the enable read back decides.
        """
        maps = (inputs, outputs)
        places = [self._places(number, one) for number, one in enumerate(maps)]
        for one, blocks in zip(maps, places, strict=True):
            for block, (record, _) in enumerate(blocks):
                for subindex, value in one.records(block):
                    yield from self._channel.put(self._target(record, subindex), value, deadline)
        for name, blocks in zip(_NAMES, places, strict=True):
            for block, (_, enable) in enumerate(blocks):
                yield from self._enable(f"{name}, block {block + 1}", enable, deadline)
        self._tell(inputs, outputs)
        return {"value": {"inputs": str(inputs), "outputs": str(outputs)}, "acts": "after power-on"}

    def _enable(self, name: str, index: int, deadline: int) -> Steps[None]:
        try:
            yield from self._channel.put(self._target(index, 0), t.ENABLED, deadline)
        except CommandError as error:
            if error.kind != "parameter" or error.number in _NO_ACCESS:
                raise
        got = yield from self._get(index, 0, deadline)
        if got != t.ENABLED:
            raise CommandError(
                "parameter",
                f"write_map: the drive does not confirm the enable of {name} ({index:04X}h is {got:02X}h): it does not "
                f"have a parameter of the map, or not with this length, or not as process data",
            )

    def _tell(self, inputs: PdMap, outputs: PdMap) -> None:
        self._notice("the process data map acts after the next power-on of the drive")
        telegram = self._telegram
        for name, one, octets in (("inputs", inputs, telegram.inputs), ("outputs", outputs, telegram.outputs)):
            if one.octets != octets:
                self._notice(
                    f"the map has {one.octets} octets of {name}, {telegram.name} has {octets}: they must be equal "
                    f"(Fb00 and Fb37, Fb12 and Fb38)"
                )

    def _places(self, number: int, one: PdMap) -> list[tuple[int, int]]:
        """Record and enable of each block that the map uses, block 1 always."""
        return [_FIRST[number]] + ([self._block2(number)] if one.block(1) else [])

    def _block2(self, number: int) -> tuple[int, int]:
        found = self._second[number]
        if found is None:
            raise CommandError(
                "usage",
                f"{_NAMES[number]}: more than {BLOCK} octets need block 2, whose indexes on the bus are not in the "
                f"manual: give the option block2_{_NAMES[number]} (record and enable in hex)",
            )
        return found

    def _get(self, index: int, subindex: int, deadline: int) -> Steps[int]:
        return self._channel.get(self._target(index, subindex), deadline)

    def _target(self, index: int, subindex: int) -> Target:
        return Target(index, subindex, f"{index:04X}h:{subindex}")


#: errors of the access itself, not of an enable
_NO_ACCESS: Final = frozenset(
    code.number
    for code in (t.READ_AND_WRITE, t.NO_INVERTER, t.WRITE_PROTECTED, t.PASSWORD, t.BAD_INDEX, t.BAD_SUBINDEX)
)
