"""The model of a simulated process device: its blocks by slot and index, its process, its clock.

Pure: octets and times in, octets out. :class:`~dpstack.pa.simulated.slave.ProcessSlave` puts it on a bus.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final, cast

from dpstack.dpv1.pdu.error_codes import Code
from dpstack.errors import RecordRefused, UsageError
from dpstack.pa.datatypes import datatype, encode_value
from dpstack.pa.simulated import faults
from dpstack.pa.simulated.block import MAX_RECORD, Block
from dpstack.pa.simulated.conversion import convert
from dpstack.pa.simulated.directory_records import LIES, Layout
from dpstack.pa.simulated.faults import EVENTS, DiagnosisEvent
from dpstack.pa.simulated.inputs import AnalogueInput, FunctionBlock
from dpstack.pa.simulated.outputs import Output
from dpstack.pa.simulated.physical import PhysicalBlock
from dpstack.pa.simulated.transducers import ActuatorTransducer, Transducer
from dpstack.units import NEVER, NS_PER_S

#: lies of a device for tests, beside those of the directory
OTHER_LIES: Final = ("long views", "maker's unit", "control characters", "changing", "short parameters")
#: a maker's unit code, and a text that must not reach a terminal
MAKERS_UNIT: Final = 0x8123
HOSTILE: Final = b"\x1b[2J\x1b]0;owned\x07<b>&\r\n\x9b1m\xff\x00"
#: degrees of maintenance
MAINTENANCE: Final = {"required": faults.REQUIRED, "demanded": faults.DEMANDED, "alarm": faults.ALARM}


class ProcessDevice:
    """A device of ``blocks``: the physical block, function blocks in the order of their slots, transducer blocks.

    ``process``: the values that the process has beside the device, by name; a caller sets them. ``lie``: one of
    :data:`~dpstack.pa.simulated.directory_records.LIES` or :data:`OTHER_LIES`, empty for an honest device. Raises
    UsageError.
    """

    def __init__(
        self,
        blocks: Sequence[Block],
        process: Mapping[str, float],
        *,
        layout: Layout | None = None,
        condensed: bool = False,
        lie: str = "",
    ) -> None:
        if lie and lie not in (*LIES, *OTHER_LIES):
            raise UsageError(f"no lie {lie!r}; known: {', '.join((*LIES, *OTHER_LIES))}")
        self.layout = layout or Layout()
        self.lie = lie
        #: time of the last computation, in ns
        self.now = 0
        self.process = dict(process)
        self.blocks = tuple(blocks)
        #: names that people give the values of the function blocks, by the name of the block
        self.names: dict[str, str] = {}
        #: keys of the events that stand, as somebody ordered them
        self.active: set[str] = set()
        #: somebody ordered fail-safe
        self.fails_safe = False
        #: somebody operates it on site
        self.is_local = False
        #: a master ordered the address 126
        self.address_reset = False
        for block in self.blocks:
            block.device = self
        self.physical = cast("PhysicalBlock", self.blocks[0])
        self.layout.place(self.blocks)
        self._condensed = condensed
        self._code(condensed)
        self._reads = 0
        if lie in ("maker's unit", "control characters"):
            self._spoil()
        self.settle()

    def __repr__(self) -> str:
        return f"<ProcessDevice {', '.join(block.name for block in self.blocks)}>"

    def _code(self, condensed: bool) -> None:
        self.physical.put("cond_status_diag", int(condensed))
        self.physical.enable(condensed)

    def reset(self) -> None:
        """All parameters as delivered (FACTORY_RESET 1)."""
        for block in self.blocks:
            revision = block.whole("st_rev")
            block.reset()
            block.put("st_rev", revision % 0xFFFF + 1)
        self._code(self._condensed)

    # -- its parts -----------------------------------------------------------------------------------------------------

    @property
    def transducers(self) -> list[Transducer]:
        """The transducer blocks in their order."""
        return [block for block in self.blocks if isinstance(block, Transducer)]

    @property
    def functions(self) -> list[FunctionBlock]:
        """The function blocks in the order of their slots."""
        return [block for block in self.blocks if isinstance(block, FunctionBlock)]

    def block(self, name: str) -> Block:
        """A block by its name, ``PB``, ``AI1``. Raises UsageError with the known ones."""
        found = next((block for block in self.blocks if block.name == name.strip().upper()), None)
        if found is None:
            raise UsageError(f"no block {name!r}; it has {', '.join(block.name for block in self.blocks)}")
        return found

    @property
    def revision(self) -> int:
        """Profile_Revision of its block objects."""
        return 0x0302 if self.layout.profile == 3 else 0x0200

    @property
    def condensed(self) -> bool:
        """Whether status and diagnosis are condensed."""
        ordered = self.physical.ordered
        return self.physical.condensed if ordered is None else ordered

    def order_coding(self, condensed: bool | None) -> None:
        """The coding that Set_Prm orders; None: COND_STATUS_DIAG decides."""
        self.physical.ordered = condensed
        self.physical.enable(bool(self.physical.whole("cond_status_diag")) if condensed is None else condensed)
        self.settle()

    # -- faults --------------------------------------------------------------------------------------------------------

    @property
    def events(self) -> tuple[DiagnosisEvent, ...]:
        """The events of DIAGNOSIS that stand."""
        standing = set(self.active)
        if any(block.is_outside() for block in self.transducers):
            standing.add(faults.OUTSIDE)
        if any(isinstance(block, ActuatorTransducer) and block.calibrating for block in self.transducers):
            standing.add(faults.CHECK)
        return tuple(event for event in EVENTS if event.key in standing)

    @property
    def status(self) -> int:
        """The status octet of a measured value, without limits."""
        switches = cast("bytes", self.physical.get("diag_event_switch"))
        return faults.status_of(self.events, self.condensed, switches)

    @property
    def is_checked(self) -> bool:
        """Whether somebody simulates a value or operates the device on site."""
        return self.is_local or any(block.is_simulated for block in self.functions)

    @property
    def is_blocked(self) -> bool:
        """Whether the valve cannot move."""
        return any(isinstance(block, ActuatorTransducer) and block.blocked for block in self.transducers)

    # -- time ----------------------------------------------------------------------------------------------------------

    def advance(self, now: int) -> None:
        """Compute the device up to ``now`` in ns; a time before the last one computes nothing."""
        while self.now < now:
            due = min((block.due for block in self.functions if isinstance(block, Output)), default=NEVER)
            until = min(now, max(due, self.now + 1)) if due < now else now
            seconds = (until - self.now) / NS_PER_S
            self.now = until
            self._compute(seconds)

    def settle(self) -> None:
        """Compute the device without a step of time, after something changed."""
        self._compute(0.0)

    def _compute(self, seconds: float) -> None:
        for block in self.blocks:
            block.settle()
        for transducer in self.transducers:
            transducer.step(seconds)
        for function in self.functions:
            function.step(seconds)
            function.settle()
        self.physical.step(seconds)

    def unit_changed(self, block: Block, name: str, before: int) -> None:
        """The unit of a transducer's values changed: PV_SCALE of the inputs that follow it does too."""
        after = block.whole(name)
        for one in self.functions:
            source = one.source
            if isinstance(one, AnalogueInput) and source and source[0] is block and source[1] in block.units[name]:
                one.follow_unit(lambda value: convert(value, before, after))

    # -- records -------------------------------------------------------------------------------------------------------

    def read(self, slot: int, index: int, now: int | None = None) -> bytes:
        """The octets of a record. Raises RecordRefused with the code of the refusal."""
        self.advance(self.now if now is None else now)
        if slot == self.layout.directory_slot and index < len(records := self.directory):
            return records[index]
        block = self._at(slot, index)
        octets = block.read(index - block.index)
        return self._lied(block, index - block.index, octets) if self.lie else octets

    def write(self, slot: int, index: int, octets: bytes, now: int | None = None) -> None:
        """Write a record. Raises RecordRefused with the code of the refusal."""
        self.advance(self.now if now is None else now)
        if slot == self.layout.directory_slot and index < len(self.directory):
            raise RecordRefused(Code.ACCESS_DENIED)
        block = self._at(slot, index)
        relative = index - block.index
        name = next((one.name for one in block.parameters.values() if one.relative == relative), "")
        if name and not self.physical.allows(name):
            raise RecordRefused(Code.ACCESS_DENIED)
        block.write(relative, octets)
        self.settle()

    @property
    def directory(self) -> list[bytes]:
        """The records of the directory, from index 0."""
        return self.layout.directory(self.blocks, self.lie)

    def _at(self, slot: int, index: int) -> Block:
        found = next(
            (one for one in self.blocks if one.slot == slot and one.index <= index <= one.index + one.count), None
        )
        if found is not None:
            return found
        known = {block.slot for block in self.blocks} | {self.layout.directory_slot}
        raise RecordRefused(Code.INVALID_INDEX if slot in known else Code.INVALID_SLOT)

    # -- lies ----------------------------------------------------------------------------------------------------------

    def _lied(self, block: Block, relative: int, octets: bytes) -> bytes:
        self._reads += 1
        if self.lie == "long views":
            if relative == 0:
                return octets[:19] + b"\xff"
            return octets.ljust(MAX_RECORD, b"\x55") if relative == block.count else octets
        if self.lie == "short parameters" and relative not in (0, 1):
            return octets[:-1]
        if self.lie == "changing":
            return self._changed(block, relative, octets)
        return octets

    def _changed(self, block: Block, relative: int, octets: bytes) -> bytes:
        """Another answer in each read: ST_REV counts, block objects change their class, texts their end."""
        if relative == 0:
            return octets[:3] + bytes((octets[3] ^ (self._reads & 1) << 4,)) + octets[4:]
        if relative == 1:
            return self._reads.to_bytes(2, "big")
        return octets[:-1] + bytes((0x30 + self._reads % 10,)) if len(octets) >= 16 else octets

    def _spoil(self) -> None:
        """Maker's unit codes, or texts that must not reach a terminal."""
        for block in self.blocks:
            for one in block.parameters.values():
                if self.lie == "control characters" and one.kind.startswith("text"):
                    block.put_octets(one.name, HOSTILE[: datatype(one.kind).length].ljust(datatype(one.kind).length))
                elif self.lie == "maker's unit" and one.name == "out_scale":
                    scale = cast("Mapping[str, float]", block.get(one.name))
                    block.put_octets(one.name, encode_value("scaling", {**scale, "unit": MAKERS_UNIT, "decimals": 2}))
