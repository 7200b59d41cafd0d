"""Comparison of the settings that a plugin relies on with those in the drive.

It runs when data exchange begins, after each write that concerns it, and before each start. The plugin declares each
setting as a :class:`Setting`. The comparison runs in the background, one request of the parameter channel at a time, so
that an order of the application waits for one of them at most. ``start()`` waits for the result.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Final, NamedTuple, Protocol

from msgspec import Struct

from dpstack.profile.channel.base import ParameterChannel, ParamKey
from dpstack.profile.model.drive_type import CHECK_SETTINGS, TelegramSpec
from dpstack.profile.model.jobs import CommandError, Steps
from dpstack.profile.model.params import POWER_ON, Use
from dpstack.profile.model.status import SettingsState
from dpstack.units import NS_PER_S

#: for one request: record 47 takes 1.4 s for one element at 9.6 kbit/s beside four drives
_ANSWER_NS: Final = 5 * NS_PER_S
_NO_ANSWER: Final = "the drive has not yet answered"


class Setting(Struct, frozen=True, kw_only=True):
    """A setting of the drive that a plugin relies on.

    ``wanted``: the expected setting, for people (``F03 = 60 Hz``). ``keys``: the parameters that show it, none if
    the status word or a learned map does. ``differs`` gets their values in this order and returns a text that says what
    the drive has and what to set, or None if it is as expected. ``refuse``: ``start()`` is refused while it differs,
    because scale or source of the set point is another one; otherwise the text is a notice. ``why`` and ``source`` are
    for the commissioning sheet: the reason for the setting, and the section of the manual.
    """

    wanted: str
    keys: tuple[ParamKey, ...]
    #: gets the values of ``keys`` in this order; returns what the drive has and what to set, or None if it is as
    #: expected
    differs: Callable[[Sequence[float]], str | None]
    refuse: bool = True
    why: str = ""
    source: str = ""


def equal(
    name: str,
    expected: float,
    remedy: str,
    *,
    unit: str = "",
    refuse: bool = True,
    why: str = "",
    source: str = "",
) -> Setting:
    """``name`` has the value ``expected``; ``remedy`` says what to do otherwise, ``{}`` in it is the drive's value."""
    suffix = f" {unit}" if unit else ""

    def differs(values: Sequence[float]) -> str | None:
        (value,) = values
        if same(value, expected):
            return None
        return f"{name} is {value:g}{suffix}, not {expected:g}{suffix}: {remedy.format(f'{value:g}')}"

    return Setting(
        wanted=f"{name} = {expected:g}{suffix}",
        keys=(ParamKey(name),),
        differs=differs,
        refuse=refuse,
        why=why,
        source=source,
    )


def same(value: float, expected: float) -> bool:
    """Equal within 0.01, the step of a parameter with two decimals."""
    return abs(value - expected) < 0.01


class CheckedCore(Protocol):
    """Master side of a drive as the comparison uses it (:class:`~dpstack.profile.master.core.DriveCore`)."""

    telegram: TelegramSpec
    access: ParameterChannel | None
    now: int
    online: bool

    def all_settings(self) -> Sequence[Setting]: ...
    def before_settings(self, deadline: int) -> Steps[None]: ...
    def settings_judged(self) -> None: ...
    def use_of(self, key: ParamKey) -> Use: ...
    def same_parameter(self, one: ParamKey, other: ParamKey) -> bool: ...
    def answers_until(self, deadline: int) -> int: ...
    def spawn(self, op: str, steps: Steps[dict[str, object]]) -> None: ...
    def update(self) -> None: ...
    def notice(self, text: str) -> None: ...


class Pending(NamedTuple):
    """A parameter that was written and does not yet act, and why not (the column ``acts`` of its table)."""

    key: ParamKey
    label: str
    acts: str

    @property
    def text(self) -> str:
        when = "from the drive's next power-on" if self.acts == POWER_ON else f"when {self.acts} is written with 1"
        return f"{self.label} was written and acts {when}; until then the old value counts"


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
        """Differences, settings that were not checked, and parameters that do not yet act, for people."""
        return (*self._differences, *self._unchecked, *(one.text for one in self._pending))

    def differs(self, use: Use) -> str | None:
        """The first difference that refuses a start among the parameters of this ``use``, else None."""
        return self._by_use.get(use)

    def reset(self) -> None:
        """Forget all results: the drive left data exchange, and what waited for its power-on may act now."""
        self._known = False  # there is a result of this stay
        self._pending: list[Pending] = []
        self._acting: dict[ParamKey, float] = {}  # the values that count while others are stored
        self._values: dict[ParamKey, float] = {}
        self._restart()

    def begin(self) -> None:
        """Data exchange has begun, or a result may be old: read and compare everything."""
        core = self._core
        self._restart()
        settings = core.all_settings()
        if not core.online or not settings:
            core.settings_judged()
        elif not self._enabled:
            self._end([_not_checked(f"the option {CHECK_SETTINGS} is false", settings)])
        elif core.access is None:
            self._end([_not_checked(f"{core.telegram.name} has no parameter channel", settings)])
        else:
            self._busy = True
            core.spawn("settings", self._compare(self._turn))

    def in_clear(self) -> Steps[dict[str, object]] | None:
        """The comparison in Clear, for the caller to step; None if nothing can be read there, which is reported."""
        core = self._core
        settings = core.all_settings()
        if not settings or not self._enabled:
            return None
        if core.access is None or core.access.needs_outputs:
            name = core.telegram.name
            why = f"{name} has no parameter channel"
            if core.access is not None:
                why = f"the parameter channel of {name} is silent in Clear, they are compared in Operate"
            self._report(_not_checked(why, settings))
            return None
        self._restart()
        return self._compare(self._turn)

    def changed(self) -> None:
        """A parameter was written, or another data set is active: read again at once."""
        if self._core.online:
            self.begin()

    def known(self, deadline: int) -> Steps[None]:
        """Before a start: read again, as a keypad passes no plugin, and wait for the result.

        Raises CommandError if the drive cannot be started as it is set. Without an answer in time an earlier result
        of this stay counts.
        """
        core = self._core
        before = self._known and not self._unchecked
        if not self._busy:
            self.begin()
        until = core.answers_until(deadline)
        while self._busy and core.now < until and not self._refused:
            yield
        if self._refused:
            raise CommandError("fault", "; ".join(self._refused))
        if self._busy:
            settings = core.all_settings()
            self._report(_not_again(settings) if before else _not_checked(_NO_ANSWER, settings))
        for text in self._unchecked:
            self._report(text)

    # -- writes of parameters -------------------------------------------------------------------------------------

    def keep(self, key: ParamKey, deadline: int) -> Steps[None]:
        """Before a write of ``key`` that does not act at once: the present values of the settings count until then."""
        access = self._core.access
        assert access is not None
        for one in self._keys(self._core.all_settings()):
            if one not in self._acting and self._core.same_parameter(one, key):
                value = self._values.get(one)
                if value is None:
                    found = (yield from access.read(one, deadline))["value"]
                    assert isinstance(found, (int, float))
                    value = found
                self._acting[one] = value

    def waits(self, pending: Pending) -> None:
        """A parameter was written that does not act at once."""
        core = self._core
        self._pending = [one for one in self._pending if not core.same_parameter(one.key, pending.key)] + [pending]
        core.notice(pending.text)
        core.update()

    def applied(self, name: str) -> None:
        """The parameter ``name`` was written, so those that waited for it act now."""
        core = self._core
        over = [one for one in self._pending if one.acts == name]
        self._pending = [one for one in self._pending if one not in over]
        self._acting = {
            key: value
            for key, value in self._acting.items()
            if not any(core.same_parameter(key, one.key) for one in over)
        }

    # -- inside ---------------------------------------------------------------------------------------------------

    def _restart(self) -> None:
        self._turn += 1
        self._busy = False
        self._differences: list[str] = []
        self._refused: list[str] = []  # those of them that refuse a start
        self._unchecked: list[str] = []
        self._by_use: dict[Use, str] = {}

    @staticmethod
    def _keys(settings: Sequence[Setting]) -> list[ParamKey]:
        return list(dict.fromkeys(key for setting in settings for key in setting.keys))

    def _compare(self, turn: int) -> Steps[dict[str, object]]:
        core, access = self._core, self._core.access
        assert access is not None
        settings: Sequence[Setting] = core.all_settings()
        found: dict[ParamKey, float] = {}
        refused: dict[ParamKey, str] = {}
        silent = ""
        try:
            yield from core.before_settings(core.now + _ANSWER_NS)
            if turn != self._turn:
                return {}
            settings = core.all_settings()
            self._judge(settings, found)  # those that need no parameter
            keys = self._keys(settings)
            size = access.per_request
            for at in range(0, len(keys), size):
                part = keys[at : at + size]
                for key, entry in zip(part, (yield from access.read_many(part, core.now + _ANSWER_NS)), strict=True):
                    value = entry.get("value")
                    if isinstance(value, (int, float)):
                        found[key] = self._acting.get(key, value)
                    else:
                        refused[key] = str(entry.get("text"))
                if turn != self._turn:
                    return {}
                self._judge(settings, found)
        except CommandError as error:
            silent = error.text
        if turn != self._turn:
            return {}
        self._values = found
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
                        for key in setting.keys:
                            self._by_use.setdefault(self._core.use_of(key), text)
                    self._report(text, "; start is refused until then" if setting.refuse else "")

    def _end(self, unchecked: list[str]) -> None:
        self._unchecked = unchecked
        self._busy, self._known = False, True
        self._reported &= set(self.texts)
        self._core.settings_judged()
        self._core.update()

    def _report(self, text: str, more: str = "") -> None:
        """Report ``text`` once while it holds: a drive that comes and goes must not fill a log."""
        if text not in self._reported:
            self._reported.add(text)
            self._core.notice(text + more)


def _not_checked(why: str, settings: Sequence[Setting]) -> str:
    return f"settings not checked: {why}; the plugin relies on {_wanted(settings)}"


def _not_again(settings: Sequence[Setting]) -> str:
    known = f"as the drive had them before, it has {_wanted(settings)}"
    return f"settings not read again before this start: {_NO_ANSWER}; {known}"


def _wanted(settings: Sequence[Setting]) -> str:
    return ", ".join(one.wanted for one in settings)
