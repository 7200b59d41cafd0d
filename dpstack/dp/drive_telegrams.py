"""The telegrams that a drive may be set to, and the words for a drive that is set to another one than configured."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple


class OtherTelegram(NamedTuple):
    """``text``: the telegram of the drive and the configured one; ``remedy``: both ways out."""

    text: str
    remedy: str


class DriveTelegrams:
    """``configured``: the name of the telegram in the configuration. ``named``: the name of the drive's telegram with
    these identifier octets, empty if it has none. ``settings``: what sets the drive to a telegram, by its name
    (``o30 = 3``), in force after ``acts``; empty: not known, or the drive follows its master."""

    def __init__(
        self, configured: str, named: Callable[[bytes], str], settings: Mapping[str, str], acts: str = ""
    ) -> None:
        self._configured = configured
        self._named = named
        self._settings = settings
        self._acts = acts

    def other(self, actual: bytes) -> OtherTelegram | None:
        """The words for a drive that names ``actual`` by Get_Cfg; None if that is no other telegram of it."""
        name, wanted = self._named(actual), self._configured
        if not name or name == wanted:
            return None
        own, change = self._settings.get(name), self._settings.get(wanted)
        text = f"the drive is set to {name}{f' ({own})' if own else ''}, the configuration has {wanted}"
        change = f"set the drive to {wanted}" if change is None else f"{change} and {self._acts}"
        return OtherTelegram(text, f'set telegram = "{name}", or {change}')
