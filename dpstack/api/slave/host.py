"""Protocol of the bus that slaves, drives and class 2 services use."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Final, Protocol

from dpstack.api.config.config import Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.services import Services
from dpstack.api.streams import Rounds
from dpstack.dp.master.commands import Mode
from dpstack.dp.master.events import ForcedClear
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.runtime import Runtime
from dpstack.drivers.snapshots import View
from dpstack.params import BusParams

#: tokens of orders to drive plugins
TOKENS: Final = itertools.count(1)


class Host(Protocol):
    """The bus as its slaves use it, see :class:`dpstack.api.bus.parts.BusBase`."""

    config: Config
    services: Services
    forced_clear: ForcedClear | None

    @property
    def params(self) -> BusParams: ...
    @property
    def runtime(self) -> Runtime: ...
    @property
    def view(self) -> View: ...
    @property
    def mode(self) -> Mode: ...
    @property
    def rounds(self) -> Rounds: ...
    @property
    def rotation_limit_s(self) -> float: ...
    def command(self, command: object) -> None: ...
    async def order(self, command: object) -> None: ...
    async def load_layouts(self) -> None: ...
    def check_open(self) -> None: ...
    async def until(self, condition: Callable[[], bool], timeout: float | None = None) -> None: ...
    async def until_round(self, condition: Callable[[], bool], timeout: float | None = None) -> None: ...
    def fitting(self, slave: SlaveConfig) -> SlaveParams: ...
    def poll_interval_ns(self, slave: SlaveParams) -> int: ...
