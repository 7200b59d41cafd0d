"""Calls a slave's drive plugin and catches its exceptions, so that the bus goes on.

After an exception the slave's outputs are set to their safe values, and the master reports a fault of kind PLUGIN.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from dpstack.dp.error_origin import innermost_call
from dpstack.dp.master import fault_texts
from dpstack.dp.master.events import DriveEvent, Fault
from dpstack.dp.master.slave_reports import SlaveReports
from dpstack.dp.process_image import CyclicPlugin, SlaveImage
from dpstack.dp.slave_params import SlaveParams

#: Exceptions of a plugin. sys.exit() is one: beyond the plugin it would leave the master in the middle of a token hold.
FAILURES: Final = (Exception, SystemExit)


class PluginHost:
    """Calls the drive plugin of one slave (``image.plugin``), if it has one. One host for each slave handler."""

    def __init__(self, image: SlaveImage, setup: SlaveParams, reports: SlaveReports) -> None:
        #: the exception that the plugin raised, as a fault; from then on the plugin is not called any more
        self.fault: Fault | None = None
        self._image = image
        self._address = setup.address
        self._name = setup.name
        self._safe = setup.safe_outputs
        self._reports = reports

    def outputs(self, now: int) -> bytes:
        """The outputs of the next Data_Exchange in Operate: the plugin's, after its failure the safe values."""
        image = self._image
        plugin = image.plugin
        if plugin is not None and self.fault is None:
            try:
                outputs = plugin.cyclic(image.inputs if image.valid else b"", now)
                if outputs is not image.next_outputs:
                    image.outputs = outputs
                if events := plugin.take_events():
                    self._report(events, now)
            except FAILURES as error:
                self._fail(plugin, error, now)
        return image.next_outputs

    def watch(self, now: int) -> None:
        """In Clear: show the plugin the inputs, if it wants to see them (see :class:`CyclicPlugin`)."""
        image = self._image
        plugin = image.plugin
        watch = getattr(plugin, "watch", None)
        if plugin is not None and watch is not None and self.fault is None:
            self._call(plugin, now, watch, image.inputs if image.valid else b"", now)

    def command(self, op: str, args: Mapping[str, object], token: int, now: int) -> None:
        """Hand an order to the plugin. Without a plugin, or after its failure, report an event with the error."""
        plugin = self._image.plugin
        if plugin is None or self.fault is not None:
            why = "has no drive plugin" if plugin is None else "is faulted: its plugin failed"
            text = f"{self._name} {why}"
            result = {"type": "result", "token": token, "ok": False, "error": "usage", "text": text}
            self._reports.event(DriveEvent, now, payload=result)
            return
        self._call(plugin, now, plugin.command, op, args, token, now)

    def lost(self, now: int) -> None:
        """Data exchange ended, or outputs went to their safe values: the plugin ends its pending orders."""
        plugin = self._image.plugin
        if plugin is not None and self.fault is None:
            self._call(plugin, now, plugin.lost, now)

    def moved(self) -> str | None:
        """The place of a slave that stopped answering, if the plugin has given it another address."""
        plugin = self._image.plugin
        if plugin is None or self.fault is not None:
            return None
        try:
            return plugin.moved(self._address)
        except FAILURES:  # no fault: the loss of the slave is reported without it
            return None

    def safe_outputs(self) -> bytes:
        """The outputs that the master sends before it leaves Operate or gives the slave up.

        The configured safe values, unless the plugin asks for others of the same length.
        """
        plugin = self._image.plugin
        if plugin is None or self.fault is not None:
            return self._safe
        return self._safe_outputs_of(plugin)

    def _safe_outputs_of(self, plugin: CyclicPlugin) -> bytes:
        try:
            found = plugin.safe(self._safe)
        except FAILURES:  # no fault: the master stops sending outputs to this slave anyway
            return self._safe
        return found if len(found) == len(self._safe) else self._safe

    def remind(self, now: int) -> None:
        """Report the fault of a failed plugin again, because the slave is in data exchange again."""
        if self.fault is not None:
            self._reports.set_fault(self.fault, now)

    def _call(self, plugin: CyclicPlugin, now: int, method: Callable[..., None], *args: object) -> None:
        try:
            method(*args)
            self._report(plugin.take_events(), now)
        except FAILURES as error:
            self._fail(plugin, error, now)

    def _report(self, payloads: list[dict[str, object]], now: int) -> None:
        if not payloads:
            return
        import json  # here, as most buses have no drive

        for payload in payloads:
            json.dumps(payload, ensure_ascii=False).encode()  # else a bus process could not send it
            self._reports.event(DriveEvent, now, payload=payload)

    def _fail(self, plugin: CyclicPlugin, error: BaseException, now: int) -> None:
        self._safe = self._safe_outputs_of(plugin)
        self.fault = fault_texts.plugin(error)
        self._image.outputs = self._safe
        self._reports.set_fault(self.fault, now)
        failed = {"type": "failed", "text": f"{type(error).__name__}: {error}"}
        where = innermost_call(error.__traceback__)
        if where:
            failed["where"] = where
        self._reports.event(DriveEvent, now, payload=failed)
