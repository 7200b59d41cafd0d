"""The orders of a device that is no drive, with their answers."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from typing import Final, Protocol

from dpstack.api.slave.host import TOKENS, Host
from dpstack.argcheck import is_number
from dpstack.dp.master.commands import DriveCommand
from dpstack.errors import BusError, DpError, SlaveError, SlaveTimeout, UsageError
from dpstack.profile.master.device_core import DeviceCore
from dpstack.profile.model.jobs import LARGEST
from dpstack.text import did_you_mean

#: seconds: the plugin checks time-outs once a rotation; after this time its answer is late
_GRACE: Final = 0.25
#: that an order takes beside the time of its device
_ROTATIONS: Final = 8


class Ordered(Protocol):
    """The slave of the device, see :class:`dpstack.api.slave.slave.Slave`."""

    @property
    def address(self) -> int: ...
    @property
    def who(self) -> str: ...
    @property
    def held_because(self) -> str | None: ...


class DeviceOrders:
    """The orders of the device behind ``slave``. ``core``: a copy of its plugin, which knows them."""

    def __init__(self, bus: Host, core: DeviceCore) -> None:
        self._bus = bus
        self.core = core
        self._pending: dict[int, asyncio.Future[object]] = {}
        self._why_over: DpError | None = None

    async def order(self, slave: Ordered, op: str, timeout: float | None, args: Mapping[str, object]) -> object:
        """See :meth:`dpstack.api.slave.slave.Slave.order`."""
        known = self.core.operations
        if op not in known:
            hint = did_you_mean(op, tuple(known), f"it has {', '.join(known) or 'none in this telegram'}")
            raise UsageError(f"{slave.who} has no order {op!r}; {hint}")
        if timeout is None:  # an order waits some times for outputs to leave and inputs to come
            timeout = known[op] + _ROTATIONS * self._bus.rotation_limit_s
        if not is_number(timeout) or not 0 <= timeout <= LARGEST:
            raise UsageError(f"{slave.who}: {op}: timeout must be a number of seconds, not {timeout!r}")
        token = next(TOKENS)
        future: asyncio.Future[object] = asyncio.get_running_loop().create_future()
        self._pending[token] = future
        given = {name: value for name, value in args.items() if value is not None}
        try:
            await self._bus.order(DriveCommand(slave.address, op, {**given, "timeout_s": timeout}, token))
            async with asyncio.timeout(timeout + _GRACE + self._bus.rotation_limit_s):
                return await future
        except TimeoutError as error:
            if isinstance(error, DpError):
                raise
            why = slave.held_because or "no answer from its plugin"
            raise SlaveTimeout(slave.address, f"{slave.who}: {op}: {why}") from None
        finally:
            if future.done() and not future.cancelled():
                future.exception()  # asyncio reports one that nobody has asked for
            if self._pending.pop(token, None) is not None and self._why_over is None:
                # the caller was cancelled or its time is over: it must not take effect later
                with contextlib.suppress(UsageError, BusError):
                    self._bus.command(DriveCommand(slave.address, "cancel", {"order": token}, next(TOKENS)))

    # --- from the bus -------------------------------------------------------------------------------------------

    def on_payload(self, slave: Ordered, payload: Mapping[str, object]) -> None:
        """Handle the ``payload`` of an event of the plugin."""
        if payload.get("type") == "failed":
            self._refuse(lambda: SlaveError(slave.address, f"{slave.who}: its plugin failed: {payload.get('text')}"))
            return
        token = payload.get("token")
        future = self._pending.pop(token, None) if isinstance(token, int) and payload.get("type") == "result" else None
        if future is None or future.done():
            return
        if payload.get("ok"):
            future.set_result(payload.get("value"))
        else:
            future.set_exception(_error(slave, payload))

    def end(self, error: DpError) -> None:
        """The bus has ended, or the slave was removed."""
        self._why_over = error
        self._refuse(lambda: error)

    def _refuse(self, error: Callable[[], DpError]) -> None:
        pending, self._pending = self._pending, {}
        for future in pending.values():
            if not future.done():
                future.set_exception(error())


def _error(slave: Ordered, payload: Mapping[str, object]) -> DpError:
    kind, text = payload.get("error"), f"{slave.who}: {payload.get('text')}"
    if kind == "usage":
        return UsageError(text)
    if kind == "timeout":
        return SlaveTimeout(slave.address, text)
    if kind == "lost" and (why := slave.held_because) is not None:
        text = f"{text}: {why}"
    return SlaveError(slave.address, text)
