"""The master's end: all is declared but what keeps the drive from starting."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from acme_drive import table as t
from dpstack.profile import CommandError, DeclaredCore, DriveProfile, Setting, Steps, TelegramSpec, equal, settled


class AcmeCore(DeclaredCore):
    """Without the status bit ``remote`` the drive does not obey the bus, and ``start()`` says what to do about it."""

    def __init__(
        self, profile: DriveProfile, name: str, telegram: TelegramSpec, options: Mapping[str, bool | float | str]
    ) -> None:
        super().__init__(t.DECLARED, profile, name, telegram, options)

    def obstacle(self) -> str | None:
        """By the status word alone."""
        if t.STATUS.told(self.status_word, "remote"):
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
