"""The master's end: all is declared but what keeps the drive from starting."""

from __future__ import annotations

from collections.abc import Sequence

from acme_drive import table as t
from dpstack.profile import CommandError, DriveCore, Setting, Steps, equal, settled


class AcmeCore(DriveCore):
    """Without the status bit ``remote`` the drive does not obey the bus, and ``start()`` says what to do about it."""

    table = t.TABLE
    scan_ns = t.SCAN_NS
    inputs = ("status", "speed", "current", "fault")
    scale = t.SPEED
    current_scale = t.CURRENT
    fault_names = t.FAULTS
    parameter_table = t.PARAMETERS

    def obstacle(self) -> str | None:
        """By the status word alone."""
        if t.STATUS.is_set(self.status_word, "remote"):
            return None
        return "the bus does not control the drive (status bit 3 is 0): set parameter 1 (source) to 1"

    def settings(self) -> Sequence[Setting]:
        """100 % is what the option says."""
        hz = self.reference_hz
        return (equal("reference", hz, f"set parameter 5 = {hz:g} or the option reference_hz = {{}}", unit="Hz"),)

    def prepare(self, deadline: int) -> Steps[None]:
        """Before a start: fail with the reason, not with a time-out."""
        yield from settled(self, lambda: self.obstacle() is None, deadline)
        why = self.obstacle()
        if why is not None:
            raise CommandError("fault", why)
