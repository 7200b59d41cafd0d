"""A bus as a listener hears it: its monitor, and of each slave the last octets and bring-ups, for reports and stories.

Nobody is asked. A report or a story has only what came over the line in the time of listening, and says so.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Final

from dpstack.api.config.config import Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.station_report import UNASKED, StationReading, no_octets
from dpstack.capture.timing import FILE, LineTiming
from dpstack.capture.transmission import Transmission
from dpstack.decode.telegram import Explained, Explainer
from dpstack.dp.master.bring_ups import DATA_EXCHANGE, BringUps
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.scanner import Found
from dpstack.dp.pdu.diagnosis import Diagnosis, SlaveView, view_of
from dpstack.dp.services import EMPTY_STATUS, SERVICE_NAMES
from dpstack.fdl.interface import Failure, StationStats
from dpstack.fdl.telegram import (
    FC_FUNCTION,
    SAP_CHK_CFG,
    SAP_GET_CFG,
    SAP_SET_PRM,
    SAP_SLAVE_DIAG,
    Kind,
    Req,
    StationType,
    Telegram,
)
from dpstack.monitor.counters import State, Station
from dpstack.monitor.devices import Devices
from dpstack.monitor.monitor import Monitor
from dpstack.params import UNADDRESSED
from dpstack.why.evidence import HEARD, Evidence, LineCounters, Neighbour, Ring
from dpstack.why.story import Story, tell

_EXCHANGES: Final = frozenset((Req.SRD_LOW, Req.SRD_HIGH, Req.MSRD))
_BRING_UP: Final = frozenset((SAP_SLAVE_DIAG, SAP_SET_PRM, SAP_CHK_CFG, SAP_GET_CFG))


@dataclass(slots=True, eq=False)
class HeardSlave:
    """The last octets of one slave, and its bring-ups. ``state``: as its master handles it, by the telegrams."""

    bring_ups: BringUps = field(default_factory=BringUps)
    state: SlaveState = SlaveState.OFFLINE
    diagnosis: Diagnosis | None = None
    #: identifier octets: of Chk_Cfg, which the slave has acknowledged, and its own ones (Get_Cfg)
    accepted: bytes | None = None
    config: bytes | None = None
    inputs: bytes = b""
    outputs: bytes = b""
    exchanged_ns: int = 0
    entered_ns: int = 0
    #: the master that asked last
    asker: int | None = None

    def leave(self, state: SlaveState, now: int) -> None:
        """Go to ``state``, from data exchange or another one."""
        if self.state is SlaveState.DATA_EXCHANGE:
            self.bring_ups.left_exchange(now, now - self.entered_ns)
        self.state = state


class HeardBus:
    """Takes the transmissions of one bus (:meth:`add`); ``monitor`` judges it."""

    def __init__(self, devices: Devices | None = None, begun_ns: int | None = None) -> None:
        self.monitor = Monitor(LineTiming(FILE, None), devices=devices, begun_ns=begun_ns)
        self._explainer = Explainer()
        self._asked: Explained | None = None  # the last request to one station
        self._garbled = False  # octets that nobody can read came after it
        self._slaves: dict[int, HeardSlave] = {}

    def add(self, one: Transmission) -> None:
        """Take a transmission. Never raises, whatever the octets."""
        self.monitor.add(one)
        found = self._explainer.add(one)
        telegram, asked = found.telegram, self._asked
        if telegram is None:
            self._garbled = self._garbled or found.step.probably_answers is not None
            return
        now = one.t_ns or 0
        if telegram.is_request or telegram.kind is Kind.SD4:
            if asked is not None and asked.telegram is not None:
                self._ended(asked.telegram, Failure.GARBLED if self._garbled else Failure.NO_ANSWER, now)
            is_asking = telegram.kind is not Kind.SD4 and telegram.da <= UNADDRESSED
            self._asked, self._garbled = (found if is_asking else None), False
        elif asked is not None and asked.telegram is not None and found.step.answer_to == asked.number:
            self._asked, self._garbled = None, False
            self._ended(asked.telegram, telegram, now)

    def _ended(self, request: Telegram, outcome: Telegram | Failure, now: int) -> None:
        """``request`` was answered, or nobody answered it."""
        sap = request.dsap
        if request.fc & FC_FUNCTION not in _EXCHANGES or (sap is not None and sap not in _BRING_UP):
            return
        slave = self._slaves.setdefault(request.da, HeardSlave())
        slave.asker = request.sa
        self._follow(slave, request.da, now)
        if sap is None:
            self._exchanged(slave, request, outcome, now)
            return
        slave.bring_ups.answered(slave.state, SERVICE_NAMES[sap], request.data, outcome, now)
        if not isinstance(outcome, Telegram):
            return
        if sap == SAP_SET_PRM and outcome.kind is Kind.SC:
            slave.state = SlaveState.SET_PRM
        elif sap == SAP_CHK_CFG and outcome.kind is Kind.SC:
            slave.state, slave.accepted = SlaveState.CHK_CFG, request.data
        elif sap == SAP_GET_CFG and outcome.data:
            slave.config = outcome.data
        elif sap == SAP_SLAVE_DIAG and (found := Diagnosis.parse(outcome.data)) is not None:
            slave.diagnosis = found
            refuses = found.prm_fault or found.cfg_fault or found.not_supported
            if found.prm_req or refuses:
                slave.leave(SlaveState.FAULT if refuses else SlaveState.DIAGNOSIS, now)

    def _follow(self, slave: HeardSlave, address: int, now: int) -> None:
        """The monitor judges whether the slave has left data exchange."""
        station = self.monitor.counters.stations.get(address)
        if slave.state is SlaveState.DATA_EXCHANGE and station is not None and station.state != State.DATA_EXCHANGE:
            slave.leave(SlaveState.OFFLINE, now)

    def _exchanged(self, slave: HeardSlave, request: Telegram, outcome: Telegram | Failure, now: int) -> None:
        """Data_Exchange has ended."""
        good = isinstance(outcome, Telegram) and (outcome.kind is Kind.SC or outcome.fc & FC_FUNCTION in EMPTY_STATUS)
        if not good:
            slave.bring_ups.answered(slave.state, DATA_EXCHANGE, request.data, outcome, now)
            self._follow(slave, request.da, now)
            return
        assert isinstance(outcome, Telegram)
        if slave.state is not SlaveState.DATA_EXCHANGE:
            slave.state, slave.entered_ns = SlaveState.DATA_EXCHANGE, now
            slave.bring_ups.entered_exchange()
            slave.bring_ups.first_exchange(request.data, outcome, now)
        slave.exchanged_ns = now
        slave.outputs, slave.inputs = request.data, outcome.data

    # --- answers ---
    def stations(self, names: dict[int, str]) -> list[dict[str, Any]]:
        """The stations that were heard, with the keys of ``scan``; ``names`` by address."""
        counters = self.monitor.counters
        found = {one: Found(address=one, kind=StationType.MASTER_IN_RING) for one in counters.masters}
        for address, station in counters.stations.items():
            if station.is_present and not station.is_master and address not in found:
                found[address] = self._found(address, station)
        return [{"config": None, **found[one].as_dict(), "name": names.get(one)} for one in sorted(found)]

    def _found(self, address: int, station: Station) -> Found:
        slave = self._slaves.get(address, HeardSlave())
        exchanging = station.state == State.DATA_EXCHANGE
        known = slave.diagnosis is not None
        state = SlaveView.DATA_EXCHANGE if exchanging else view_of(slave.diagnosis) if known else None
        return Found(
            address=address,
            kind=StationType.SLAVE if station.station_type is None else station.station_type,
            state=state,
            ident=station.ident,
            master=station.master if exchanging else None,
            config=slave.config or slave.accepted,
        )

    def reading(self, address: int, seconds: float) -> StationReading:
        """The reading of the station at ``address``, after ``seconds`` of listening."""
        found = no_octets()
        errors: dict[str, str] = {}
        station, slave = self.monitor.counters.stations.get(address), self._slaves.get(address)
        heard = f"in {seconds:g} s of listening"
        if address in self.monitor.counters.masters:
            return StationReading(
                address, None, HEARD, "master", **found, errors={"Slave_Diag": f"it holds the token {heard}"}
            )
        if station is None or slave is None:
            why = f"nobody asked station {address} {heard}" if station is None else f"it was only looked for {heard}"
            return StationReading(address, None, HEARD, UNASKED, **found, errors={"Slave_Diag": why})
        exchanging = station.state == State.DATA_EXCHANGE
        if (config := slave.config or slave.accepted) is not None:
            found["config"] = config.hex()
        if exchanging and slave.exchanged_ns:
            found["outputs"], found["inputs"] = slave.outputs.hex(), slave.inputs.hex()
        if station.in_vain and not exchanging:
            return StationReading(
                address, None, HEARD, "", **found, errors={"Slave_Diag": f"its master asked in vain {heard}"}
            )
        # an older diagnosis may be of the time before data exchange
        if slave.diagnosis is not None and (view_of(slave.diagnosis) is SlaveView.DATA_EXCHANGE) == exchanging:
            found["diagnosis"] = slave.diagnosis.build().hex()
            return StationReading(address, None, HEARD, "", **found, errors=errors)
        errors["Slave_Diag"] = f"its master did not ask for it {heard}"
        state = SlaveView.DATA_EXCHANGE.value if exchanging else None
        return StationReading(address, None, HEARD, UNASKED, **found, errors=errors, state=state, master=station.master)

    def story(self, config: Config, slave: SlaveConfig) -> Story:
        """Why ``slave`` of ``config`` is, or is not, in data exchange with its master."""
        heard, counters = self._slaves.get(slave.address, HeardSlave()), self.monitor.counters
        begun, now, setup = self.monitor.begun_ns, counters.ended_ns, slave.params
        # the slaves of a configuration that is read only have another master, the PLC for instance
        other = heard.asker if config.bus.read_only else None
        own = config.bus.address if other is None else other
        master = counters.masters.get(own)
        modules = () if setup.texts is None else setup.texts.modules
        params = config.params(counters.baud or config.baud)
        return tell(
            Evidence(
                setup=setup,
                state=heard.state,
                source=HEARD,
                now_ns=now,
                started_ns=begun,
                since_ns=begun,
                diagnosis=heard.diagnosis,
                history=heard.bring_ups.history(),
                link=_link(counters.stations.get(slave.address)),
                neighbours=tuple(self._neighbour(one) for one in config.slaves if one is not slave),
                exchanged_ns=heard.exchanged_ns,
                device=slave.device,
                modules=modules,
                expected_prm=slave.expected_user_prm,
                rates=slave.baud_rates,
                config=heard.config,
                ring=Ring(
                    own=own,
                    joined=master is not None and master.in_ring and not master.is_silent,
                    asks=bool(counters.stations),
                    masters=frozenset(counters.masters),
                    tokens=sum(one.tokens for one in counters.masters.values()),
                ),
                line=LineCounters(
                    baud=params.baud,
                    slot_bits=params.t_sl,
                    min_tsdr=params.min_tsdr,
                    heard=counters.telegrams,
                    bad=counters.damaged,
                    longest_ns=0 if master is None else master.rotation_ns.max_ns,
                ),
            )
        )

    def _neighbour(self, slave: SlaveConfig) -> Neighbour:
        heard = self._slaves.get(slave.address, HeardSlave())
        return Neighbour(
            slave.address,
            slave.name,
            heard.state,
            slave.params.ident,
            _link(self.monitor.counters.stations.get(slave.address)),
            None if heard.diagnosis is None else heard.diagnosis.ident,
            heard.exchanged_ns,
        )


def _link(station: Station | None) -> StationStats:
    """The counters of a master for the station, as far as a listener has them."""
    if station is None:
        return StationStats()
    repeated = station.repetitions
    return StationStats(
        requests=station.requests - repeated,
        answers=station.answers,
        retries=repeated,
        timeouts=max(0, station.no_answer + station.damaged - repeated),
        late=station.late,
        bad={"damaged": station.damaged} if station.damaged else {},
    )
