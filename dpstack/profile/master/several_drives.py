"""Master side of a slave with several drives: one plugin that holds a core for each of them.

Each drive has its own part of inputs and outputs, which its core alone reads and makes. An order names its drive, and
so does every event (key :data:`DRIVE`).

A failed core ends all drives of its slave: the outputs of the slave leave as one telegram, and the axes of one machine
are coupled mechanically more often than not. So the master sends the safe outputs of all of them.

A slave has one request and one response of record 47 at a time, whatever object they are for. So the drives take turns,
and each has references of its own, so that no drive takes the late response to another one.
"""

from __future__ import annotations

import contextlib
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple, NoReturn

from dpstack.dp.process_image import DRIVE as DRIVE
from dpstack.dpv1.master.plugin_queue import RecordQueue
from dpstack.profile.master.core import DriveCore
from dpstack.profile.model.status import DriveStatus
from dpstack.profile.record47.client import PLUGIN
from dpstack.profile.record47.drive_access import AcyclicAccess
from dpstack.text import octets_text

#: keys in the arguments of an order: the name of the drive as in events, and its own arguments
ARGUMENTS: Final = "arguments"
#: drives in one slave: they share 127 references of record 47
MOST_DRIVES: Final = 16
_FAILURES: Final = (Exception, SystemExit)


class CoreError(Exception):
    """The core of one of the drives raised an exception."""


class DrivePart(NamedTuple):
    """A drive and its octets in the process image of its slave: of each direction the first, and the one behind the
    last."""

    core: DriveCore
    inputs: tuple[int, int]
    outputs: tuple[int, int]


class SeveralDrives:
    """Implements :class:`dpstack.dp.process_image.CyclicPlugin` for the drives ``parts`` of one slave.

    ``octets``: length of its outputs; those of no drive are 0. ``records``: queue of the Reads and Writes of all
    drives.
    """

    def __init__(self, parts: Sequence[DrivePart], octets: int, records: RecordQueue | None = None) -> None:
        #: the cores by name
        self.cores: Mapping[str, DriveCore] = {part.core.name: part.core for part in parts}
        self.records = records
        self._parts = [(part.core, slice(*part.inputs), slice(*part.outputs)) for part in parts]
        self._made: list[bytes] = [b""] * len(parts)
        self._outputs = bytes(octets)
        self._events: list[dict[str, object]] = []
        self._has_failed = False
        turns: deque[object] = deque()
        share = len(PLUGIN) // len(parts)
        for number, part in enumerate(parts):
            first = PLUGIN.start + number * share
            if isinstance(part.core.access, AcyclicAccess):
                part.core.access.take_turns(turns, range(first, first + share))

    @staticmethod
    def core(
        parts: Sequence[tuple[DriveCore, tuple[int, int], tuple[int, int]]], octets: int, records: RecordQueue | None
    ) -> SeveralDrives:
        """The plugin of a slave in its bus process."""
        return SeveralDrives([DrivePart(*part) for part in parts], octets, records)

    # -- CyclicPlugin -----------------------------------------------------------------------------------------------

    def cyclic(self, inputs: bytes, now: int) -> bytes:
        made, changed = self._made, False
        for number, (core, of_inputs, _) in enumerate(self._parts):
            try:
                octets = core.cyclic(inputs[of_inputs], now)
            except _FAILURES as error:
                self._fail(core, error)
            if octets is not made[number]:
                made[number], changed = octets, True
        if changed:
            self._outputs = self._joined(self._outputs, made)
        return self._outputs

    def watch(self, inputs: bytes, now: int) -> None:
        """See :class:`~dpstack.dp.process_image.CyclicPlugin`."""
        self._each(lambda core, part: core.watch(inputs[part], now))

    def lost(self, now: int) -> None:
        self._each(lambda core, _: core.lost(now))

    def safe(self, configured: bytes) -> bytes:
        """Each drive's own; of one that fails here the configured ones."""
        found = []
        for core, _, part in self._parts:
            own = configured[part]
            with contextlib.suppress(*_FAILURES):
                wanted = core.safe(own)
                own = wanted if len(wanted) == len(own) else own
            found.append(own)
        return self._joined(configured, found)

    def moved(self, address: int) -> str | None:
        return next((where for core in self.cores.values() if (where := core.moved(address)) is not None), None)

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None:
        """The order ``op`` to the drive whose name is in ``args``."""
        core, given = self.cores.get(str(args.get(DRIVE))), args.get(ARGUMENTS)
        if core is None or not isinstance(given, Mapping):
            text = f"an order must name one of {', '.join(self.cores)}"
            self._events.append({"type": "result", "token": token, "ok": False, "error": "usage", "text": text})
            return
        try:
            core.command(op, given, token, now)
        except _FAILURES as error:
            self._fail(core, error)

    def take_events(self) -> list[dict[str, object]]:
        """Those of all drives, each with the name of its drive."""
        found, self._events = self._events, []
        for name, core in self.cores.items():
            found += [{**payload, DRIVE: name} for payload in core.take_events()]
        return found

    # -- for the application ----------------------------------------------------------------------------------------

    def status(self) -> dict[str, DriveStatus]:
        """The status of each drive by its name, for a bus process."""
        return {name: self.status_of(name) for name in self.cores}

    def status_of(self, name: str) -> DriveStatus:
        """The status of a drive; unknown once one of the drives has failed, as none is called any more."""
        status = self.cores[name].status()
        return status.unknown() if self._has_failed else status

    # -- inside -----------------------------------------------------------------------------------------------------

    def _each(self, act: Callable[[DriveCore, slice], None]) -> None:
        """Call ``act`` for every drive, whatever another one raises."""
        failed: tuple[DriveCore, BaseException] | None = None
        for core, inputs, _ in self._parts:
            try:
                act(core, inputs)
            except _FAILURES as error:
                failed = failed or (core, error)
        if failed is not None:
            self._fail(*failed)

    def _fail(self, core: DriveCore, error: BaseException) -> NoReturn:
        self._has_failed = True
        failure = CoreError(f"drive {core.name}: {type(error).__name__}: {error}")
        raise failure.with_traceback(error.__traceback__) from error

    def _joined(self, whole: bytes, parts: Sequence[bytes]) -> bytes:
        """``whole`` with the ``parts`` of the drives."""
        joined = bytearray(whole)
        for (core, _, part), octets in zip(self._parts, parts, strict=True):
            if len(octets) != part.stop - part.start:
                wrong = f"{octets_text(len(octets))} of outputs instead of {part.stop - part.start}"
                self._fail(core, ValueError(wrong))
            joined[part] = octets
        return bytes(joined)
