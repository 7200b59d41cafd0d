"""Alarms of a served slave: raised from async code, over when its master has acknowledged them."""

from __future__ import annotations

import asyncio
from collections.abc import Iterable, Sequence

from dpstack.dpv1.pdu.alarms import Alarm, ModuleState, Status, module_status
from dpstack.dpv1.slave.alarms import AlarmEnd, AlarmServer, Raised
from dpstack.errors import AlarmError, SlaveTimeout, UsageError


class ServedAlarms:
    """The alarms of one slave. ``server`` None: its type has no DP-V1, every call raises UsageError."""

    def __init__(self, server: AlarmServer | None, name: str) -> None:
        self._server = server
        self._name = name

    async def alarm(self, alarm: Alarm, address: int, timeout: float | None) -> None:
        """Raise it and wait. Cancelled or too late, it is withdrawn where the master has not seen it yet."""
        server = self._known()
        raised = server.alarm(alarm)
        over: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        raised.ended = lambda: None if over.done() else over.set_result(None)
        try:
            async with asyncio.timeout(timeout):
                await over
        except TimeoutError:
            what = f"slave {address} ({self._name}): {alarm.text}: not acknowledged after {timeout} s"
            raise SlaveTimeout(address, f"{what}; {_hint(raised)}") from None
        finally:
            raised.ended = None
            if raised.end is None:
                server.withdraw(raised)
        if raised.end is not None and raised.end is not AlarmEnd.ACKNOWLEDGED:
            text = f"slave {address} ({self._name}): {alarm.text}: {raised.end.value}"
            raise AlarmError(text, "data exchange ended" if raised.end is AlarmEnd.LEFT else "withdrawn")

    def status(self, status: Status) -> None:
        """Tell it once."""
        self._known().status(status)

    def module_status(self, states: Sequence[ModuleState]) -> None:
        """A module status of ``states``, slot 1 first."""
        given = tuple(states) if isinstance(states, Iterable) else (states,)
        if not given or any(not isinstance(state, int) or state not in range(4) for state in given):
            raise UsageError(
                f"{states!r} is no list of ModuleState: ModuleState.OK, .INVALID, .WRONG or .MISSING for each"
            )
        self.status(module_status(tuple(ModuleState(state) for state in given)))

    def _known(self) -> AlarmServer:
        if self._server is None:
            raise UsageError(f"slave {self._name}: it has no DP-V1, so no alarms; say dpv1=True in its description")
        return self._server


def _hint(raised: Raised) -> str:
    if raised.offered:
        return "its master has read it in the diagnosis, but sends no Alarm_Ack"
    return "its master has not fetched it: others are before it, or the master does not heed diagnosis messages"
