"""Faults of simulated slaves by name, and of the line.

They are the steps of scenarios, with the same names, keys and checks.
"""

from __future__ import annotations

from types import TracebackType
from typing import Final, Literal

from dpstack.api.control.scenario import NORMAL, kind_of
from dpstack.api.control.simulation_handlers import slave_handlers
from dpstack.api.slave_side.fault_steps import End
from dpstack.api.slave_side.virtual_bench import VirtualBench
from dpstack.errors import ConfigError
from dpstack.sim.transmission import Transmission
from dpstack.sim.world import World
from dpstack.toml.table import Source, Table
from dpstack.units import ns_to_s, s_to_ns

#: a year in seconds
_LONGEST_S: Final = 365 * 86_400


class Fault:
    """A fault that has begun. As a context manager it ends with its block. ``text``: the fault for people."""

    def __init__(self, text: str, slave: str | None, end: End | None) -> None:
        self.text = text
        #: name of the slave; None for the line
        self.slave = slave
        self._end = end
        #: bus time in seconds at which it ends by itself; None: it does not
        self.until: float | None = None

    def __repr__(self) -> str:
        return f"<Fault {self.slave or 'line'}: {self.text}>"

    @property
    def acts(self) -> str | None:
        """The fault with its end in bus time, for people; None: it has ended, or has no end."""
        if self._end is None:
            return None
        return self.text if self.until is None else f"{self.text} until {self.until:.6f} s"

    def __enter__(self) -> Fault:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.end()

    def end(self) -> None:
        """End the fault; nothing happens if it has ended before, or has no end (a trip)."""
        end, self._end = self._end, None
        if end is not None:
            end()


class Faults:
    """Faults of the simulated slaves of one line. Slaves are named by name or address.

    A fault begins at once, while virtual time stands still. ``for_s``: it ends by itself after so many seconds of bus
    time; None: by ``Fault.end()``, :meth:`clear`, or never. A fault replaces an earlier one of its kind at the same
    slave; diagnoses add up. Raises UsageError for an unknown slave, ConfigError for values outside their range.
    """

    def __init__(self, bench: VirtualBench, world: World, master: int) -> None:
        self._bench = bench
        self._handlers = slave_handlers(bench)
        self._world = world
        self._master = master
        self._begun: list[Fault] = []
        self._muted = 0  # faults that silence the master
        self._drops = False

    # --- slaves -----------------------------------------------------------------------------------------------------

    def silence(self, slave: str | int, for_s: float | None = None) -> Fault:
        """Deaf and mute, as with its plug pulled; its outputs stay until its watchdog expires."""
        return self.begin(slave, "silence", for_s)

    def power_off(self, slave: str | int, for_s: float | None = None) -> Fault:
        """Switched off, and on again at the end; a drive keeps its EEPROM."""
        return self.begin(slave, "power_off", for_s)

    def late_answers(self, slave: str | int, by_ms: float = 20.0, for_s: float | None = None) -> Fault:
        """Every answer begins ``by_ms`` later, 0.01 to 10,000; until then the slave hears nothing."""
        return self.begin(slave, "late_answers", for_s, by_ms=by_ms)

    def rs(self, slave: str | int, status: Literal["RS", "RR", "UE"] = "RS", for_s: float | None = None) -> Fault:
        """Data_Exchange is refused with ``status`` and does not reach the device; all other services work."""
        return self.begin(slave, "rs", for_s, status=status)

    def wrong_length(self, slave: str | int, by_octets: int | None = None, for_s: float | None = None) -> Fault:
        """Inputs with ``by_octets`` more octets, or with fewer; None: one fewer, one more if it has no inputs."""
        return self.begin(slave, "wrong_length", for_s, by_octets=by_octets)

    def noise(self, slave: str | int, rate: float = 1e-3, seed: int | None = None, for_s: float | None = None) -> Fault:
        """Noise on the stub of this slave: each bit that it hears or sends is inverted with the probability ``rate``,
        1e-9 to 0.5. ``seed`` None: its address."""
        return self.begin(slave, "noise", for_s, rate=rate, seed=seed)

    def repeated_answers(self, slave: str | int, for_s: float | None = None) -> Fault:
        """Every answer is sent twice."""
        return self.begin(slave, "repeated_answers", for_s)

    def diagnosis(
        self,
        slave: str | int,
        what: str | None = None,
        *,
        error: str | int | None = None,
        text: str | None = None,
        octets: bytes | None = None,
        slot: int | None = None,
        channel: int | None = None,
        direction: Literal["input", "output", "both"] | None = None,
        state: Literal["ok", "data invalid", "wrong module", "no module"] | None = None,
        alarm: bool = False,
        fault: bool = True,
        for_s: float | None = None,
    ) -> Fault:
        """A diagnosis beside that of the device and others that act: ``what`` ("slot 3 channel 0 line break", "slot 2
        no module", or any text of the GSD file), or its parts: ``slot``, ``channel`` and ``error`` (a word or number
        of a channel error, or a text of the GSD file), ``state`` of the module; or the ``octets`` of its blocks.
        ``alarm``: an alarm of DP-V1 at its begin and at its end. ``fault=False``: without Ext_Diag.
        """
        return self.begin(
            slave,
            "diagnosis",
            for_s,
            what=what,
            error=error,
            text=text,
            octets=octets,
            slot=slot,
            channel=channel,
            direction=direction,
            state=state,
            alarm=alarm or None,
            fault=fault,
        )

    def trip(self, slave: str | int, code: str) -> Fault:
        """A fault of a simulated drive by its code or name, until the master acknowledges it."""
        return self.begin(slave, "trip", code=code)

    def begin(self, slave: str | int, do: str, for_s: float | None = None, **keys: object) -> Fault:
        """The step ``do`` of a scenario with its keys (docs/how-to/simulate.md#scenarios), None: left out. Commands
        too: ``begin("io", "wire_break", args=["3", "0", "on"])``."""
        address, name = self._find(slave)
        table = Table(Source("faults"), (), {key: value for key, value in keys.items() if value is not None}, do)
        do = do.replace("-", "_")
        if do == NORMAL:
            self.clear(name)
            return Fault(do, name, None)
        kind = kind_of(table, do, self._handlers)
        deed = kind.read(table, table.read(kind.keys), self._bench, address)
        if for_s is not None and not kind.lasting:
            raise ConfigError(f"{do} has no end of its own; leave for_s out")
        for_ns = _for_ns(for_s)
        return self._run(Fault(deed.text, name, deed.begin()), for_ns)

    # --- the line ---------------------------------------------------------------------------------------------------

    def silence_master(self, for_s: float | None = None) -> Fault:
        """No station hears the master: the watchdogs of the slaves expire, as with the plug of the master pulled."""
        for_ns = _for_ns(for_s)
        if not self._drops:
            self._drops = True
            self._world.faults.drop(self._is_muted, times=None)
        self._muted += 1

        def end() -> bool:
            self._muted -= 1
            return True

        return self._run(Fault("no station hears the master", None, end), for_ns)

    def line_noise(self, per_bit: float) -> None:
        """From now on each bit on the line is inverted with the probability ``per_bit`` (0..0.5); 0 ends it."""
        self._world.faults.noise(per_bit)

    # --- all --------------------------------------------------------------------------------------------------------

    @property
    def active(self) -> dict[str, list[str]]:
        """The faults that act at this moment, for people: slave -> texts. Slaves without one are left out."""
        found = {name: self._active(address, name) for address, name in self._bench.names().items()}
        return {name: texts for name, texts in found.items() if texts}

    def _active(self, address: int, name: str) -> list[str]:
        """The faults that the slave has, those that were begun here with their end."""
        begun = {one.text: one.acts for one in self._begun if one.slave == name and one.acts is not None}
        texts = []
        for text in self._bench.injected(address):
            own = next((one for one in begun if text.startswith(one) or text.replace("-", " ").startswith(one)), None)
            texts.append(text if own is None else begun[own])
        return texts

    def clear(self, slave: str | int | None = None) -> None:
        """End every fault that was begun here, or those of ``slave``; noise on the line too, without ``slave``."""
        name = None if slave is None else self._find(slave)[1]
        for fault in self._begun:
            if name in (None, fault.slave):
                fault.end()
        self._begun = [fault for fault in self._begun if name not in (None, fault.slave)]
        if name is None:
            self._world.faults.noise(0.0)

    def _run(self, fault: Fault, for_ns: int | None) -> Fault:
        if for_ns is not None:
            fault.until = ns_to_s(self._bench.now + for_ns)
            self._bench.call_at(self._bench.now + for_ns, fault.end)
        self._begun.append(fault)
        return fault

    def _is_muted(self, tx: Transmission) -> bool:
        return self._muted > 0 and tx.telegram is not None and tx.telegram.sa == self._master

    def _find(self, slave: str | int) -> tuple[int, str]:
        address = self._bench.address_of(slave)
        return address, self._bench.units[address].name


def _for_ns(for_s: float | None) -> int | None:
    if for_s is None:
        return None
    if not 0 < for_s <= _LONGEST_S:
        raise ConfigError(f"for_s = {for_s!r}: give seconds, more than 0 and at most {_LONGEST_S}")
    return s_to_ns(for_s)
