"""Runs a slave's cyclic unit (a drive plugin) so that its defects stay its own.

An exception sets that slave's outputs to their safe values, is reported as a fault of kind PLUGIN, and does not disturb
the bus.
"""

from __future__ import annotations

from collections.abc import Mapping

from dpstack.dp.master import fault_texts
from dpstack.dp.master.events import DriveEvent, Fault
from dpstack.dp.master.slave_reports import SlaveReports
from dpstack.dp.process_image import CyclicUnit, SlaveImage
from dpstack.dp.slave_params import SlaveParams


class UnitHost:
    """The cyclic unit of one slave."""

    def __init__(self, image: SlaveImage, setup: SlaveParams, reports: SlaveReports) -> None:
        #: set once and for all when the unit raises
        self.fault: Fault | None = None
        self._image = image
        self._name = setup.name
        self._safe = setup.safe_outputs
        self._reports = reports

    def outputs(self, now: int) -> bytes:
        """The outputs of the next Data_Exchange in Operate: the unit's, the application's, or the safe ones."""
        image = self._image
        unit = image.unit
        if unit is None:
            return image.latched
        if self.fault is None:
            try:
                image.outputs = unit.cyclic(image.inputs if image.valid else b"", now)
                self._drain(now)
            except Exception as error:
                self._fail(error, now)
        return image.outputs

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None:
        """Hand an order to the unit; where there is none, or a failed one, the answer is an event too."""
        unit = self._image.unit
        if unit is None or self.fault is not None:
            why = "has no drive plugin" if unit is None else "is faulted: its plugin failed"
            text = f"{self._name} {why}"
            result = {"type": "result", "token": token, "ok": False, "error": "usage", "text": text}
            self._reports.event(DriveEvent, now, payload=result)
            return
        try:
            unit.command(op, args, token, now)
            self._drain(now)
        except Exception as error:
            self._fail(error, now)

    def lost(self, now: int) -> None:
        """Data exchange ended or outputs went to their safe values: what the unit has pending ends."""
        unit = self._image.unit
        if unit is None or self.fault is not None:
            return
        try:
            unit.lost(now)
            self._drain(now)
        except Exception as error:
            self._fail(error, now)

    def safe_outputs(self) -> bytes:
        """The outputs of every way out, as long as they are ones that the slave can take."""
        unit = self._image.unit
        if unit is None or self.fault is not None:
            return self._safe
        return self._present(unit)

    def _present(self, unit: CyclicUnit) -> bytes:
        try:
            found = unit.safe(self._safe)
        except Exception:  # a way out is no time to fault: the outputs end here anyway
            return self._safe
        return found if len(found) == len(self._safe) else self._safe

    def remind(self, now: int) -> None:
        """The slave is in data exchange again; a failed unit still is its fault."""
        if self.fault is not None:
            self._reports.set_fault(self.fault, now)

    def _drain(self, now: int) -> None:
        unit = self._image.unit
        if unit is not None:
            for payload in unit.take_events():
                self._reports.event(DriveEvent, now, payload=payload)

    def _fail(self, error: Exception, now: int) -> None:
        if self._image.unit is not None and self.fault is None:
            self._safe = self._present(self._image.unit)
        self.fault = fault_texts.plugin(error)
        self._image.outputs = self._safe
        self._reports.set_fault(self.fault, now)
        failed = {"type": "failed", "text": f"{type(error).__name__}: {error}"}
        self._reports.event(DriveEvent, now, payload=failed)
