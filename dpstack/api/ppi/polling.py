"""``CpuPolling``: reads the named values of an S7-200 again and again, over FDL beside the DP master; their quality."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from typing import Final, Protocol

from dpstack.api.config.config import Config
from dpstack.api.config.cpu import CpuConfig, CpuValue
from dpstack.api.fdl.fdl import Fdl
from dpstack.api.fdl.link import FdlLink
from dpstack.api.ppi.cpu import Cpu
from dpstack.api.ppi.poll_plan import pdu_length_of
from dpstack.dp.master.events import FaultKind, SlaveState, SlaveStateChanged
from dpstack.dp.plan.plan import Plan
from dpstack.dp.process_image import Value, inputs_are_valid, inputs_limit_ns
from dpstack.drivers.runtime import Runtime
from dpstack.errors import CpuRefused, DpError, SlaveError, UsageError
from dpstack.plant.items import FaultValues, SlaveValues
from dpstack.plant.quality import Reason
from dpstack.plant.status_octet import read_octets
from dpstack.plant.value_quality import GOOD, Judged, trouble_of, worse
from dpstack.ppi.addresses import PpiValue
from dpstack.trace import Event, Severity
from dpstack.units import NS_PER_MS, ns_to_s


class PollingBus(Protocol):
    """The bus as the polling uses it, see :class:`dpstack.api.bus.core.BusCore`."""

    config: Config

    @property
    def plan(self) -> Plan: ...
    @property
    def runtime(self) -> Runtime: ...
    @property
    def is_open(self) -> bool: ...
    def check_open(self) -> None: ...
    def fdl_link(self) -> FdlLink: ...
    def notice(self, source: str, message: str, severity: Severity = Severity.INFO) -> None: ...
    def publish(self, event: Event) -> None: ...


#: an absent CPU is looked for no more often: each look takes bus time in vain
_LOOK_S: Final = 1.0
#: why nobody is asked on a read-only bus
READ_ONLY: Final = "on a read-only bus no CPU is asked: a request of PPI is data for it; leave read_only out"


class CpuPolling:
    """The values of the CPU of ``config``, polled over ``bus``."""

    def __init__(self, bus: PollingBus, config: CpuConfig) -> None:
        self._bus = bus
        self._cpu: Cpu | None = None
        self.config = config
        #: DATA_EXCHANGE while it answers, else OFFLINE
        self.state = SlaveState.OFFLINE
        #: why it does not answer
        self.fault: str | None = None
        #: the values of the last poll one behind the other
        self.image = bytes(config.input_fields.length)
        #: why the CPU refuses to give a value, by name
        self.refused: Mapping[str, str] = {}
        #: time in ns since which it does so
        self._refused_ns: Mapping[str, int] = {}
        #: number of times that all values were read
        self.polls = 0
        #: time of the last poll in ns, 0 before the first
        self.read_ns = 0
        self._lost_ns = 0
        self._interval_ns = config.poll_ns
        self._task: asyncio.Task[None] | None = None
        self._again = asyncio.Event()

    @property
    def ready_now(self) -> bool:
        """Whether it answers."""
        return self.state is SlaveState.DATA_EXCHANGE

    @property
    def cpu(self) -> Cpu:
        """The CPU itself. Raises UsageError when the bus is not open."""
        if self._cpu is None:
            self._bus.check_open()
            link = Fdl(self._bus.fdl_link())
            self._cpu = Cpu(link, self.config.address, pdu_length=pdu_length_of(self._bus.plan))
        return self._cpu

    # --- values and their quality -----------------------------------------------------------------------------------
    def value(self, name: str) -> Value | None:
        """The value of the last poll; None for one that the CPU refuses, and before the first poll."""
        if not self.read_ns or name in self.refused:
            return None
        return self.config.values[name].field.get(self.image)

    @property
    def limit_ns(self) -> int:
        """Age up to which values are good, in ns: 1 s, two polls at least."""
        return inputs_limit_ns(0, self._interval_ns)

    def described(self, now: int) -> SlaveValues:
        """State, age and fault at ``now``, as the live stream has them."""
        age_ns = max(0, now - self.read_ns) if self.read_ns else None
        return SlaveValues(
            state=self.state.value,
            fault=None if self.fault in (None, READ_ONLY) else FaultValues(self.fault, FaultKind.ABSENT.value),
            conspicuous=READ_ONLY if self.fault is READ_ONLY else None,
            inputs_valid=inputs_are_valid(exchanging=self.ready_now, age_ns=age_ns, limit_ns=self.limit_ns),
            inputs_age_ms=None if age_ns is None else round(ns_to_s(age_ns) * 1000, 1),
            inputs_limit_ms=round(self.limit_ns / NS_PER_MS, 1),
            exchanges=self.polls,
        )

    def judge_all(self, described: SlaveValues) -> Judged:
        """The quality of all values, with times in ns."""
        if not self.read_ns:
            return Judged(Reason.WAITING, self.fault or "")
        trouble = trouble_of(described, self.limit_ns / NS_PER_MS)
        since = self.read_ns if self.ready_now else self._lost_ns
        return GOOD if trouble is None else Judged(*trouble, since or None)

    def judge(self, name: str, of_all: Judged) -> Judged:
        """The quality of one value, ``of_all`` being that of all."""
        if name in self.refused:
            return worse(of_all, Judged(Reason.NO_VALUE, self.refused[name], self._refused_ns[name]))
        field = self.config.values[name].field
        if not field.speaks_for_itself:
            return of_all
        meaning = read_octets(field, self.image)
        return of_all if meaning.reason is Reason.GOOD else worse(of_all, Judged(*meaning, self.read_ns or None))

    # --- writing ----------------------------------------------------------------------------------------------------
    async def write(self, name: str, value: object) -> None:
        """Write a named value of a program, and read all values anew. Raises as ``PlantCpu.write``."""
        one = self.config.value(name)
        await self._write(one, self._converted(one, value))

    async def set_values(self, values: Mapping[str, object]) -> None:
        """Carry out an order from outside: each of ``values`` is one that ``allow_commands`` lists, and all are checked
        before the first is written. Raises as :meth:`write`, and SlaveError for a CPU that does not answer."""
        wanted = []
        for name, value in values.items():
            one = self.config.value(name)
            if name not in self.config.output_fields:
                raise UsageError(
                    f"{self.config.who}: {name} is read-only; list it in allow_commands of this CPU if others may "
                    "write it"
                )
            wanted.append((one, self._converted(one, value)))
        if not self.ready_now:
            raise SlaveError(self.config.address, f"{self.config.who} does not answer: nothing was written")
        for one, plain in wanted:
            await self._write(one, plain)

    def _converted(self, one: CpuValue, value: object) -> PpiValue:
        try:
            return one.plain(value)
        except ValueError as error:
            raise UsageError(f"{self.config.who}: {error}") from None

    async def _write(self, one: CpuValue, value: PpiValue) -> None:
        await self.cpu.write(one.address.text, value)
        self.poll_now()

    def poll_now(self) -> None:
        """Read all values without waiting for the next poll."""
        self._again.set()

    # --- polling ----------------------------------------------------------------------------------------------------
    def begin(self, done: Callable[[], None]) -> None:
        """Begin to poll; ``done`` is called after each poll."""
        if self._bus.config.bus.read_only:
            self.fault = READ_ONLY
            return
        self._task = asyncio.create_task(self._run(done), name=f"dpstack {self.config.who}")

    def end(self) -> None:
        """The bus ends: nothing is polled any more."""
        if self._task is not None:
            self._task.cancel()
        self.state = SlaveState.OFFLINE

    async def _run(self, done: Callable[[], None]) -> None:
        loop, pause = asyncio.get_running_loop(), self.config.poll_ms / 1000
        while True:
            begun = loop.time()
            self._again.clear()
            await self._poll()
            done()
            due = begun + (pause if self.ready_now else max(pause, _LOOK_S))
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(max(0.0, due - loop.time())):
                    await self._again.wait()

    async def _poll(self) -> None:
        begun, values = self._bus.runtime.now(), self.config.values
        try:
            found = await self.cpu.read_each([one.address.text for one in values.values()])
        except DpError as error:
            self._lose(str(error))
            return
        refused, parts = dict[str, str](), []
        for (name, one), value in zip(values.items(), found, strict=True):
            if isinstance(value, CpuRefused):
                refused[name] = str(value)
            parts.append(bytes(one.field.length) if isinstance(value, CpuRefused) else one.image_part(value))
        now = self._bus.runtime.now()
        self.image, self.read_ns, self.polls, self.fault = b"".join(parts), now, self.polls + 1, None
        self._interval_ns = max(self.config.poll_ns, now - begun) + now - begun
        for name in refused.keys() - self.refused.keys():
            self._notice(f"{name} has no value: {refused[name]}")
        self._refused_ns = {name: self._refused_ns.get(name, now) for name in refused}
        self.refused = refused
        self._change(SlaveState.DATA_EXCHANGE)

    def _lose(self, why: str) -> None:
        if not self._bus.is_open:
            return
        if why != self.fault:
            self._notice(why)
        if self.ready_now or not self._lost_ns:
            self._lost_ns = self._bus.runtime.now()
        self.fault = why
        self._change(SlaveState.OFFLINE)

    def _notice(self, text: str) -> None:
        self._bus.notice("ppi", f"{self.config.who}: {text}", Severity.WARNING)

    def _change(self, state: SlaveState) -> None:
        before, self.state = self.state, state
        if state is not before:
            now, config = self._bus.runtime.now(), self.config
            self._bus.publish(SlaveStateChanged(t_ns=now, address=config.address, name=config.name, state=state))
