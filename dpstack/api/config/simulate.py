"""The table [slave.simulate]: inputs of a simulated slave from a recording or from a function."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Final, TypedDict

from msgspec import Struct

from dpstack.errors import ConfigError
from dpstack.text import brief
from dpstack.toml.table import Key, Table, keys_of
from dpstack.units import NS_PER_MS

_FUNCTION: Final = re.compile(r"[^\W\d]\w*(?:\.[^\W\d]\w*)*:[^\W\d]\w*(?:\.[^\W\d]\w*)*")


class SimulateKeys(TypedDict, total=False):
    """The keys of [slave.simulate], as docs/reference/configuration.md has them.

    recording: a [recording](simulate.md#inputs-from-a-recording), relative to the configuration. Left out: none
    repeat: the recording begins again at its end
    function: a [Python function](simulate.md#inputs-from-a-function), `"module:function"`; the module is looked for
        beside the configuration first. Left out: none
    period_ms: the time between two calls of the function
    """

    recording: str
    repeat: bool
    function: str
    period_ms: Annotated[int, Key(5, 3_600_000)]


class SimulateConfig(Struct, frozen=True):
    """Either ``recording`` or ``function`` (MODULE:NAME). ``folder``: that of the configuration.

    ``blame``: makes the error at a key, from its name, the problem and the remedy.
    """

    folder: Path
    recording: Path | None = None
    repeat: bool = False
    function: str | None = None
    period_ms: int = 100
    blame: Callable[[str, str, str], ConfigError] | None = None

    @property
    def period_ns(self) -> int:
        return self.period_ms * NS_PER_MS

    def error(self, key: str, what: str, todo: str) -> ConfigError:
        """The ConfigError at ``key``."""
        return ConfigError(f"{what}; {todo}") if self.blame is None else self.blame(key, what, todo)


def read_simulate(table: Table, *, drive: bool) -> SimulateConfig:
    """The key ``simulate`` of a slave. ``drive``: its simulated drive makes the inputs. Raises ConfigError."""
    if drive:
        table.fail("simulate", "simulate beside drive", "the simulated drive makes its inputs: leave simulate out")
    inside = table.table("simulate", 'a table, for instance { recording = "file.csv" }')
    given = inside.read(keys_of(SimulateKeys))
    recording, function = given.get("recording"), given.get("function")
    if (recording is None) is (function is None):
        what = "recording and function" if function else "neither recording nor function"
        inside.fail(None, what, "give one of them")
    for key, other in (("repeat", "recording"), ("period_ms", "function")):
        if key in given and other not in given:
            inside.fail(key, f"{key} without {other}", f"leave {key} out")
    if function is not None and not _FUNCTION.fullmatch(function):
        inside.fail("function", f"function = {brief(function)}", 'write module:function, for instance "tank:inputs"')
    return SimulateConfig(
        folder=table.folder,
        recording=None if recording is None else table.folder / recording,
        repeat=given.get("repeat", False),
        function=function,
        period_ms=given.get("period_ms", 100),
        blame=inside.error,
    )
