"""Evidence about one slave: plain frozen data, from a running master, a class 2 look at the bus, or a listener."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from dpstack.dp.master.bring_ups import BringUp, History, Step
from dpstack.dp.master.events import Fault, SlaveState
from dpstack.dp.master.scanner import Found
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.slave_params import SlaveParams
from dpstack.fdl.interface import StationStats
from dpstack.gsd.model import Device, Module

RUN = "run"
CLASS2 = "class2"
HEARD = "heard"


@dataclass(frozen=True, slots=True)
class Neighbour:
    """Another slave of the same configuration. ``ident``: as configured; ``found_ident``: in its last diagnosis.
    ``exchanged_ns``: time of its last good Data_Exchange, 0: none."""

    address: int
    name: str
    state: SlaveState
    ident: int | None = None
    link: StationStats = field(default_factory=StationStats)
    found_ident: int | None = None
    exchanged_ns: int = 0

    @property
    def there(self) -> bool:
        """Whether it answered when it was asked last, also if it refused."""
        return self.state not in (SlaveState.OFFLINE, SlaveState.DEACTIVATED)


@dataclass(frozen=True, slots=True)
class PublisherLink:
    """A link of the slave to a publisher. ``good``: valid data come, None: not known; ``text``: its state in words."""

    publisher: int
    good: bool | None
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Ring:
    """The token ring, as the asking station sees it. ``own``: the address of the master that owns the slave by its
    configuration; ``joined``: that master is in the ring. ``masters``: the list of active stations.

    ``asks``: the master may send to slaves (not in Stop).

    ``collision``: text, if another station sends with the master's address. ``refused``: why the ring could not be
    joined, empty if it could.
    """

    own: int
    joined: bool = True
    asks: bool = True
    masters: frozenset[int] = frozenset()
    collision: str = ""
    refused: str = ""
    tokens: int = 0
    tokens_lost: int = 0
    token_retries: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class LineCounters:
    """Counters of the whole line. ``bad``: damaged telegrams and octets outside of telegrams, by cause.

    ``longest_ns``: the longest time between two rounds that was measured, 0: none. ``planned_ns``: the longest one of
    the plan. ``slot_bits``: T_SL; ``min_tsdr``: the earliest answer that the master takes; both in bit times.
    """

    baud: int
    slot_bits: int
    min_tsdr: int = 11
    heard: int = 0
    bad: Mapping[str, int] = field(default_factory=dict)
    longest_ns: int = 0
    planned_ns: int = 0
    paced: bool = True
    #: what another program did to the port, seen when slaves fell silent; empty: nothing
    disturbed: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """All that is known about the slave with ``setup``.

    ``device``, ``modules``: of its GSD file, if it has one. ``expected_prm``: the user parameters that this file
    gives for these modules, or the plugin of its drive. ``exchanged_ns``: time of its last good Data_Exchange, 0: none.
    ``rates``: baud rates that the device knows, empty: not known. ``config``: the identifier octets that the slave says
    to have (Get_Cfg), None: not asked, or not answered. ``found``: the stations of a scan, None: the bus was not
    scanned. ``unreadable``: addresses whose answers the scan could not read.
    ``since_ns``: the counters of stations and line count from this time on; a bus that runs for long is watched for a
    moment, as its counters from the start would hide a trouble of now.
    ``unknown``: addresses of stations that GAP polls have found, and that the configuration does not have.
    ``asked``: services that were asked for this story, as steps; ``asked_in_vain``: attempts at them without an answer
    in time. ``read_only``: the asking station is no class 1 master
    of the slave; ``asker``: its address.
    """

    setup: SlaveParams
    state: SlaveState
    ring: Ring
    line: LineCounters
    source: str = RUN
    now_ns: int = 0
    started_ns: int = 0
    since_ns: int = 0
    fault: Fault | None = None
    diagnosis: Diagnosis | None = None
    history: History = field(default_factory=History)
    link: StationStats = field(default_factory=StationStats)
    neighbours: tuple[Neighbour, ...] = ()
    links: tuple[PublisherLink, ...] = ()
    watchdog_ns: int = 0
    exchanged_ns: int = 0
    device: Device | None = None
    modules: tuple[Module | None, ...] = ()
    expected_prm: bytes | None = None
    rates: frozenset[int] = frozenset()
    config: bytes | None = None
    found: tuple[Found, ...] | None = None
    unreadable: frozenset[int] = frozenset()
    unknown: frozenset[int] = frozenset()
    asked: tuple[Step, ...] = ()
    asked_in_vain: int = 0
    read_only: bool = False
    asker: int = -1

    @property
    def bring_up(self) -> BringUp | None:
        """The last bring-up."""
        ups = self.history.bring_ups
        return ups[-1] if ups else None

    @property
    def steps(self) -> tuple[Step, ...]:
        """The steps of the last bring-up, then those asked for this story."""
        last = self.bring_up
        return (() if last is None else last.steps) + self.asked

    def seconds(self, t_ns: int) -> float:
        """``t_ns`` in seconds since the start."""
        return (t_ns - self.started_ns) / 1e9
