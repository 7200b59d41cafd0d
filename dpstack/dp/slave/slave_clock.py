"""The time a device asks for: its ``wake_at`` and ``tick``, kept from hanging or breaking the bus."""

from __future__ import annotations

from dpstack.dp.slave.device import Device
from dpstack.units import NEVER, NOW


class DeviceClock:
    """Asks ``device`` when it wants its time, and gives it. Exceptions come out of :meth:`tick` only."""

    __slots__ = ("_device", "_due", "_error", "idle")

    def __init__(self, device: Device) -> None:
        self._device = device
        self._error: Exception | None = None
        # a device that leaves wake_at as it is need not be asked in every step
        plain = getattr(device.wake_at, "__func__", None) is Device.wake_at
        self._due = None if plain else device.wake_at
        #: it never wants its time
        self.idle = plain

    def wake_at(self) -> int:
        """When :meth:`tick` is wanted, in ns; NOW when asking failed: the time of that is known in tick only."""
        if self._due is None:
            return NEVER
        try:
            return self._due()
        except Exception as error:
            self._error = error
            return NOW

    def tick(self, now: int) -> int | None:
        """Let the device catch up with ``now``; the address at which it restarts by itself, None where it does not.

        Raises what the device raises, and RuntimeError when it never catches up.
        """
        if self._due is None:
            return None
        if self._error is not None:
            error, self._error = self._error, None
            raise error
        due = self._due()
        restart: int | None = None
        while due <= now:
            told = self._device.tick(now)
            restart = restart if told is None else told
            before, due = due, self._due()
            if due <= before:
                raise RuntimeError(f"wake_at() stays at {due} after tick({now})")
        return restart
