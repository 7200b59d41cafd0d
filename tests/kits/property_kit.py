"""The number of examples of hypothesis: few and always the same in ``make test``, many and random in ``make soak``."""

from __future__ import annotations

from typing import Final

from hypothesis import HealthCheck, Phase, settings
from hypothesis.internal.conjecture import providers

#: examples of a test that does not say how many, in ``make test`` and in ``make soak``
_EXAMPLES: Final = 30
_SOAK_EXAMPLES: Final = 1_000
#: ``make soak`` tries so many times the examples of a test that says how many
_MORE: Final = 10
#: ``make test`` tries this share of them, and ten at least: the same ones every time, so more of them find little more
_SHARE: Final = 0.6
_LEAST: Final = 10


def register_profiles() -> None:
    """``test`` tells the first example that fails and does not shrink it, which takes minutes where worlds run.

    What would depend on the speed of the computer is off in both.
    """
    same = settings(
        deadline=None,
        database=None,
        print_blob=True,
        report_multiple_bugs=False,
        suppress_health_check=[HealthCheck.too_slow],
    )
    phases = (Phase.explicit, Phase.generate)
    settings.register_profile("test", same, derandomize=True, max_examples=_EXAMPLES, phases=phases)
    settings.register_profile("soak", same, derandomize=False, max_examples=_SOAK_EXAMPLES)
    settings.load_profile("test")
    _forget_constants_of_sources()


def _forget_constants_of_sources() -> None:
    """In ``make test`` hypothesis tries no numbers and texts that it finds in the sources of the modules loaded so far:
    a file gets other examples with others in one process than by itself. It reads all sources for them, too, which
    takes 4 s of a processor at first."""
    find = getattr(providers, "_get_local_constants", None)
    none = getattr(providers, "_local_constants", None)
    if find is not None and none is not None:  # inner names: without them, examples differ as said
        providers._get_local_constants = lambda: find() if soaking() else none


def soaking() -> bool:
    """Whether hypothesis is to look for what it has not found yet."""
    return settings.get_current_profile_name() == "soak"


def examples(count: int, *, soak: int | None = None) -> settings:
    """The settings of a test with ``count`` examples. Of more than ten ``make test`` tries three fifths, ten at least.

    ``soak``: the number in ``make soak``, None: ten times ``count``.
    """
    if soaking():
        return settings(max_examples=_MORE * count if soak is None else soak)
    return settings(max_examples=max(min(count, _LEAST), round(_SHARE * count)))
