"""A new station address that the drive got over its plugin: where it is when it no longer answers at the old one."""

from __future__ import annotations

from collections.abc import Mapping


class NewAddress:
    """``parameter``: the name of the parameter that holds the station address, "" if the drive has none; ``label``:
    it for people.

    ``acts``: when a new one takes effect, for people; "": at once, with the write. ``trigger``: the name of a parameter
    that makes it take effect at once when another value than 0 is written to it.
    """

    def __init__(self, parameter: str, label: str, acts: str, trigger: str) -> None:
        self._parameter = parameter
        self._label = label
        self._acts = acts
        self._trigger = trigger
        self._value: int | None = None
        self._has_moved = False

    def written(self, outcome: Mapping[str, object]) -> None:
        """The drive has taken a write."""
        name, value = outcome.get("name"), outcome.get("value")
        if not name or not isinstance(value, int):
            return
        if name == self._parameter:
            self._value, self._has_moved = value, not self._acts
        elif name == self._trigger and value and self._value is not None:
            self._has_moved = True

    def answered(self) -> None:
        """It is in data exchange again, at the address of its configuration."""
        if self._has_moved:
            self._value, self._has_moved = None, False

    def where(self, address: int) -> str | None:
        """Where to look for the drive that no longer answers at ``address``; None: no write has moved it."""
        new = self._value
        if new is None or new == address:
            return None
        what = f"{self._label} was set to {new} here"
        todo = f"give it address = {new} in the configuration"
        if self._has_moved:
            return f"it is at address {new} now, because {what}: {todo}"
        return (
            f"{what}, which takes effect {self._acts}: if that has happened it is at address {new} now, {todo}; "
            "otherwise check its power and the cable"
        )
