"""Limit of the writes that a drive stores: its EEPROM wears out, often after 100 000 writes of a parameter."""

from __future__ import annotations

from collections.abc import Hashable
from typing import Final

from dpstack.profile.model.jobs import CommandError
from dpstack.profile.model.params import ParamSpec
from dpstack.units import NS_PER_S, ns_to_s

#: writes of one parameter at once, and the time after which it may be written once more
BURST: Final = 100
INTERVAL_NS: Final = 60 * NS_PER_S
#: parameters beyond which those without recent writes are forgotten
_MANY: Final = 1_000


class StoredWrites:
    """Counts the stored writes of each parameter of a drive: at most :data:`BURST`, then one each :data:`INTERVAL_NS`.

    The count begins anew with the program.
    """

    def __init__(self) -> None:
        self._full_at: dict[Hashable, int] = {}  # the time at which BURST writes are possible again

    def admit(self, parameter: Hashable, label: str, now: int, spec: ParamSpec | None = None) -> None:
        """Count a write of ``parameter`` at ``now`` (ns). Raises CommandError if there were too many.

        ``label`` names the parameter in the message. A volatile ``spec`` has no limit.
        """
        if spec is not None and spec.volatile:
            return
        full_at = max(self._full_at.get(parameter, now), now)
        too_early = full_at - now - (BURST - 1) * INTERVAL_NS
        if too_early > 0:
            raise CommandError(
                "parameter",
                f"{label}: was written {BURST} times and more, and each write wears out the EEPROM of the drive; the "
                f"next one in {ns_to_s(too_early):.0f} s. Put a value that changes often into the process data, or "
                "write it with ram = true if the drive has that",
            )
        if len(self._full_at) > _MANY:
            self._full_at = {one: at for one, at in self._full_at.items() if at > now}
        self._full_at[parameter] = full_at + INTERVAL_NS
