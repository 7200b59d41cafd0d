"""What an application's drive knows of its plugin, in this process or in another."""

from __future__ import annotations

from typing import Protocol

from dpstack.profile import DriveStatus, ListedParam, TelegramSpec


class DriveSeen(Protocol):
    """What is seen of a drive's plugin, wherever it runs; see :class:`dpstack.profile.DriveCore`."""

    @property
    def drive(self) -> str:
        """What kind of drive it is."""

    @property
    def reference_hz(self) -> float:
        """The frequency that 100 % speed means."""

    @property
    def telegram(self) -> TelegramSpec:
        """The telegram it is exchanged in."""

    @property
    def access(self) -> object | None:
        """The parameter channel, where its telegram has one."""

    def parameters(self) -> tuple[ListedParam, ...]:
        """Those it declares, in the order in which they are listed."""

    def setpoint_word(self, fraction: float) -> int:
        """The set point as its word. Raises ValueError with the range."""

    def status(self) -> DriveStatus:
        """At this moment."""
