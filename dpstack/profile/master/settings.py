"""Comparison of the settings that a plugin relies on with those in the drive, when data exchange begins.

The plugin declares each as a :class:`Setting`. The comparison runs in the background, one request of the parameter
channel at a time, so that an order of the application waits for one of them at most. ``start()`` waits for the result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, Protocol

from msgspec import Struct

from dpstack.profile.channel.base import ParameterChannel, ParamKey
from dpstack.profile.model.drive_type import CHECK_SETTINGS, TelegramSpec
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.status import SettingsState
from dpstack.units import NS_PER_S

#: for one request: record 47 takes 1.4 s for one element at 9.6 kbit/s beside four drives
_ANSWER_NS: Final = 5 * NS_PER_S
_NO_ANSWER: Final = "the drive has not yet answered"


class Setting(Struct, frozen=True, kw_only=True):
    """A setting of the drive that a plugin relies on.

    ``wanted``: the expected setting, for people (``F03 = 60 Hz``). ``keys``: the parameters that tell it. ``differs``
    gets their values in this order and returns a text that says what the drive has and what to set, or None where
    it is as expected. ``refuse``: ``start()`` is refused while it differs, because scale or source of the set point
    is another one; otherwise the text is a notice.
    """

    wanted: str
    keys: tuple[ParamKey, ...]
    differs: Callable[[Sequence[float]], str | None]
    refuse: bool = True


def equal(name: str, expected: float, remedy: str, *, unit: str = "", refuse: bool = True) -> Setting:
    """``name`` has the value ``expected``; ``remedy`` says what to do otherwise, ``{}`` in it is the drive's value."""
    suffix = f" {unit}" if unit else ""

    def differs(values: Sequence[float]) -> str | None:
        (value,) = values
        if same(value, expected):
            return None
        return f"{name} is {value:g}{suffix}, not {expected:g}{suffix}: {remedy.format(f'{value:g}')}"

    return Setting(wanted=f"{name} = {expected:g}{suffix}", keys=(ParamKey(name),), differs=differs, refuse=refuse)


def same(value: float, expected: float) -> bool:
    """Equal within 0.01, the step of a parameter with two decimals."""
    return abs(value - expected) < 0.01


class CheckedCore(Protocol):
    """Master side of a drive as the comparison uses it (:class:`~dpstack.profile.master.core.DriveCore`)."""

    telegram: TelegramSpec
    access: ParameterChannel | None
    now: int

    def settings(self) -> Sequence[Setting]: ...
    def before_settings(self, deadline: int) -> Steps[None]: ...
    def answers_until(self, deadline: int) -> int: ...
    def spawn(self, op: str, steps: Steps[dict[str, object]]) -> None: ...
    def update(self) -> None: ...
    def notice(self, text: str) -> None: ...


class SettingsCheck:
    """The comparison for one drive. ``enabled``: the option ``check_settings``."""

    def __init__(self, core: CheckedCore, *, enabled: bool) -> None:
        self._core = core
        self._enabled = enabled
        self._reported: set[str] = set()
        self._turn = 0
        self.reset()

    @property
    def state(self) -> SettingsState:
        if self._differences:
            return SettingsState.DIFFERENT
        if self._busy:
            return SettingsState.CHECKING
        if self._unchecked:
            return SettingsState.NOT_CHECKED
        return SettingsState.CHECKED if self._known else SettingsState.NONE

    @property
    def texts(self) -> tuple[str, ...]:
        """Differences, and settings that were not checked, for people."""
        return (*self._differences, *self._unchecked)

    def begin(self) -> None:
        """Data exchange has begun: compare everything."""
        core = self._core
        self.reset()
        settings = core.settings()
        if not settings:
            return
        if not self._enabled:
            self._end([_not_checked(f"the option {CHECK_SETTINGS} is false", settings)])
        elif core.access is None:
            self._end([_not_checked(f"{core.telegram.name} has no parameter channel", settings)])
        else:
            self._busy = True
            core.spawn("settings", self._compare(self._turn))

    def reset(self) -> None:
        """Forget all results: the drive left data exchange."""
        self._turn += 1
        self._stale = False
        self._busy = False
        self._known = False  # there is a result
        self._differences: list[str] = []
        self._refused: list[str] = []  # those of them that refuse a start
        self._unchecked: list[str] = []

    def changed(self) -> None:
        """A parameter was written, or another data set is active: compare again before the next start."""
        self._stale = True

    def known(self, deadline: int) -> Steps[None]:
        """Before a start: wait for the result. Raises CommandError where the drive cannot be started as it is set."""
        core = self._core
        if self._stale or self._refused:  # somebody may have set it right
            self.begin()
        until = core.answers_until(deadline)
        while self._busy and core.now < until and not self._refused:
            yield
        if self._refused:
            raise CommandError("fault", "; ".join(self._refused))
        if self._busy:
            self._report(_not_checked(_NO_ANSWER, core.settings()))
        for text in self._unchecked:
            self._report(text)

    # -- inside ---------------------------------------------------------------------------------------------------

    def _compare(self, turn: int) -> Steps[dict[str, object]]:
        core, access = self._core, self._core.access
        assert access is not None
        settings: Sequence[Setting] = core.settings()
        found: dict[ParamKey, float] = {}
        refused: dict[ParamKey, str] = {}
        silent = ""
        try:
            yield from core.before_settings(core.now + _ANSWER_NS)
            settings = core.settings()
            keys = list(dict.fromkeys(key for setting in settings for key in setting.keys))
            size = access.per_request
            for at in range(0, len(keys), size):
                part = keys[at : at + size]
                for key, entry in zip(part, (yield from access.read_many(part, core.now + _ANSWER_NS)), strict=True):
                    value = entry.get("value")
                    if isinstance(value, (int, float)):
                        found[key] = value
                    else:
                        refused[key] = str(entry.get("text"))
                if turn != self._turn:
                    return {}
                self._judge(settings, found)
        except CommandError as error:
            silent = error.text
        if turn != self._turn:
            return {}
        reasons: dict[str, list[Setting]] = {}
        for setting in settings:
            if not all(key in found for key in setting.keys):
                why = silent or next(refused[key] for key in setting.keys if key in refused)
                reasons.setdefault(why, []).append(setting)
        self._end([_not_checked(*reason) for reason in reasons.items()])
        return {}

    def _judge(self, settings: Sequence[Setting], found: dict[ParamKey, float]) -> None:
        for setting in settings:
            if all(key in found for key in setting.keys):
                text = setting.differs([found[key] for key in setting.keys])
                if text is not None and text not in self._differences:
                    self._differences.append(text)
                    if setting.refuse:
                        self._refused.append(text)
                    self._report(text, "; start is refused until then" if setting.refuse else "")

    def _end(self, unchecked: list[str]) -> None:
        self._unchecked = unchecked
        self._busy, self._known = False, True
        self._reported &= set(self.texts)
        self._core.update()

    def _report(self, text: str, more: str = "") -> None:
        """Report ``text`` once while it holds: a drive that comes and goes must not fill a log."""
        if text not in self._reported:
            self._reported.add(text)
            self._core.notice(text + more)


def _not_checked(why: str, settings: Sequence[Setting]) -> str:
    return f"settings not checked: {why}; the plugin relies on {', '.join(one.wanted for one in settings)}"
