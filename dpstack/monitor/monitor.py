"""A bus judged by listening: transmissions in, events and a summary with verdicts out. No clock, memory bounded."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Final

from dpstack.capture.timing import LineTiming
from dpstack.dp.pdu.alarm_blocks import Alarm, full_text, message_dict, parse_block
from dpstack.dp.pdu.diag_blocks import DeviceBlock
from dpstack.dp.pdu.diag_texts import block_texts, conspicuous_text, first_slot_of
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.errors import PduError
from dpstack.monitor.counters import Change, Counters, State
from dpstack.monitor.devices import Devices, KnownDevice
from dpstack.monitor.evidence import finding
from dpstack.monitor.history import History
from dpstack.monitor.summary import summary
from dpstack.monitor.thresholds import Thresholds
from dpstack.monitor.timing import Timing
from dpstack.monitor.verdicts import Heard
from dpstack.stats import Histogram
from dpstack.units import NS_PER_S, baud_text

#: entries of the time line: the newest are kept
TIME_LINE: Final = 1_000
#: the JSON name of a change, as ``run --json`` has it
_EVENTS: Final = {
    "lost": "slave",
    "back": "slave",
    "state": "slave",
    "joined": "ring",
    "left": "ring",
    "rate": "notice",
}


@dataclass(frozen=True, slots=True)
class Happening:
    """Something that happened on the bus. ``t_ns``: since 1970. ``kind``: lost, back, state, diagnosis, alarm,
    status_message, mode, joined, left, rate, gap, notice. ``address``: of a station, None for the bus. ``text``: one
    line for people. ``fields``: further keys of its JSON line. ``routine``: a step of a bring-up, which is no entry of
    the time line."""

    t_ns: int
    kind: str
    address: int | None
    name: str
    text: str
    fields: Mapping[str, object] = field(default_factory=dict)
    routine: bool = False

    def as_dict(self, begun_ns: int) -> dict[str, object]:
        """The JSON line: its ``event`` is named as in ``dpstack run --json``, ``t`` in seconds since ``begun_ns``."""
        line: dict[str, object] = {
            "event": _EVENTS.get(self.kind, self.kind),
            "t": round(max(0, self.t_ns - begun_ns) / NS_PER_S, 6),
        }
        if self.address is not None:
            line |= {"address": self.address, "name": self.name or None}
        return {**line, **self.fields, "text": self.text}


class Monitor:
    """Judges one bus. :meth:`add` takes its transmissions, whose times must not run backwards; :meth:`add_all` many.

    ``timing``: of their source; it may be set later. ``begun_ns``: time since 1970 at which listening began, None: with
    the first transmission. ``on_event`` gets each :class:`Happening` as it happens; the last ones are kept in
    ``time_line``, ``left_out`` counts those that are not.
    """

    def __init__(
        self,
        timing: LineTiming,
        *,
        devices: Devices | None = None,
        thresholds: Thresholds | None = None,
        begun_ns: int | None = None,
        on_event: Callable[[Happening], None] = lambda happening: None,
    ) -> None:
        self.timing = timing
        self.devices = devices or Devices()
        self.thresholds = thresholds or Thresholds()
        self.counters = Counters(self._changed, self._look)
        self.history = History()
        self.time_line: deque[Happening] = deque(maxlen=TIME_LINE)
        self.left_out = 0
        self.add = self.counters.add
        self.add_all = self.counters.add_all
        self._begun_ns = begun_ns
        self.on_event = on_event
        self._blocks: dict[int, frozenset[bytes]] = {}  # the extended diagnosis of each station
        self._conspicuous: dict[int, str] = {}
        self._looked_ns = 0
        self._lost_ns: int | None = None  # nothing can be heard since then
        self._back_ns = 0  # the line was heard again from then on
        self._deaf_ns = 0  # time in which nothing could be heard
        self._named_baud: int | None = None  # PROFIBUS is proven at this rate
        self._told: dict[int, str] = {}  # the last state reported of each station

    @property
    def begun_ns(self) -> int:
        """When listening began, in ns since 1970; 0 before the first transmission."""
        return (self.counters.begun_ns or 0) if self._begun_ns is None else self._begun_ns

    def begin(self, now_ns: int) -> None:
        """Listening begins at ``now_ns``, in ns since 1970: opening the port took its time."""
        self._begun_ns = now_ns

    def gap(self, t_ns: int, text: str, *, since_ns: int = 0) -> None:
        """Octets are missing before ``t_ns``: put it on the time line. No duration is counted across it, and no station
        is silent because of it. ``since_ns``: the time between is none of listening; 0: there was hardly any."""
        self.counters.gap(t_ns)
        if since_ns:
            self._deaf_ns += max(0, t_ns - since_ns)
        self._tell(Happening(t_ns, "gap", None, "", text))

    def lost(self, t_ns: int, text: str) -> None:
        """From now on nothing can be heard, until :meth:`back`."""
        if self._lost_ns is None:
            self._lost_ns = t_ns
        self.gap(t_ns, text)

    def back(self, t_ns: int, text: str) -> None:
        """The line is heard again. The time since :meth:`lost` is none of listening."""
        if self._lost_ns is not None:
            self._deaf_ns += max(0, t_ns - self._lost_ns)
            self._lost_ns = None
        self._back_ns = t_ns
        self.gap(t_ns, text)

    def remark(self, t_ns: int, text: str) -> None:
        """Put a remark of the source of the octets on the time line."""
        self._tell(Happening(t_ns, "notice", None, "", text))

    def tick(self, now_ns: int) -> None:
        """Time has passed, ns since 1970: a line where nothing is heard is looked at once a second."""
        if self._lost_ns is None and now_ns - self._looked_ns >= NS_PER_S:
            self.counters.look(now_ns)

    def heard(self, now_ns: int | None = None) -> Heard:
        """All that was heard up to ``now_ns`` (ns since 1970; None: up to the end of the last transmission)."""
        counters = self.counters
        if self._lost_ns is not None:
            now_ns = self._lost_ns  # later nothing could be heard
        now = counters.ended_ns if now_ns is None else max(now_ns, counters.ended_ns)
        return Heard(
            counters=counters,
            history=self.history,
            devices=self.devices,
            timing=Timing.of(self.timing, counters),
            thresholds=self.thresholds,
            seconds=max(0, now - self.begun_ns - self._deaf_ns) / NS_PER_S if self.begun_ns else 0.0,
            silent_s=(now - max(counters.ended_ns, self._back_ns)) / NS_PER_S if counters.ended_ns else 0.0,
            now_ns=now,
            is_profibus=self._is_profibus(),
        )

    def summary(self, now_ns: int | None = None) -> dict[str, object]:
        """The summary with all verdicts, as :func:`~dpstack.monitor.summary.summary` has it."""
        return summary(self.heard(now_ns))

    def _is_profibus(self) -> bool:
        """The evidence is not taken back at the same rate: noise may outweigh it for a while."""
        counters = self.counters
        if self._named_baud != (counters.baud or None) and finding(counters).is_profibus:
            self._named_baud = counters.baud
        return self._named_baud is not None and self._named_baud == counters.baud

    # --- changes ---
    def _look(self, now: int) -> None:
        self._looked_ns = now
        self._is_profibus()
        for station in self.history.look(self.counters, now):
            if station.is_master or station.state == State.UNKNOWN or self._told.get(station.address) == station.state:
                continue
            state = station.state.replace("_", " ")
            text = "does not answer" if station.state == State.OFFLINE else f"is in {state}"
            self._state(now, "state", station.address, text)

    def _state(self, t_ns: int, kind: str, address: int, text: str) -> None:
        state = self.counters.stations[address].state
        self._told[address] = state
        routine = state not in (State.DATA_EXCHANGE, State.OFFLINE) and kind != "lost"
        self._tell_of(t_ns, kind, address, text, {"state": state}, routine=routine)

    def _changed(self, change: Change) -> None:
        t_ns, kind, address = change.t_ns, change.kind, change.address
        match kind:
            case "lost":
                self._state(t_ns, kind, address, "left data exchange")
            case "back":
                self._state(t_ns, kind, address, "exchanges data")
            case "diagnosis":
                self._diagnosed(t_ns, address, change.octets)
            case "mode":
                mode = self.counters.masters[address].mode
                self._tell_of(t_ns, kind, address, f"is in {mode.capitalize()}", {"mode": mode}, role="master")
            case "joined" | "left" | "clock":
                self._tell_of(t_ns, kind, address, change.text.removeprefix(f"master {address} "), {}, role="master")
            case "rate":
                baud = self.counters.baud
                self._forget_durations()
                text = f"the bus runs at {baud_text(baud)} now" if baud else "the rate is not known any more"
                self._tell(Happening(t_ns, kind, None, "", text, {"baud": baud}))

    def _forget_durations(self) -> None:
        """Durations at another rate are no measure for those of now."""
        for station in self.counters.stations.values():
            station.answer_ns = Histogram()
        for master in self.counters.masters.values():
            master.token_ns, master.rotation_ns, master.hold_ns = Histogram(), Histogram(), Histogram()
        self.history.forget_durations()

    def _diagnosed(self, t_ns: int, address: int, octets: bytes) -> None:
        diagnosis = Diagnosis.parse(octets)
        if diagnosis is None:
            return
        station = self.counters.stations[address]
        device = self.devices.find(address, diagnosis.ident)
        dpv1 = device.dpv1 is not False
        exchanging = station.state == State.DATA_EXCHANGE
        texts = block_texts(diagnosis, device.texts, dpv1=dpv1)
        found = conspicuous_text(diagnosis, device.texts, dpv1=dpv1, exchanging=exchanging)
        before = self._conspicuous.get(address, "")
        self._conspicuous[address] = found
        text = f"new diagnosis: {found}" if found else "its diagnosis is clear" if before else ""
        fields = {"flags": list(diagnosis.flags), "texts": list(texts)}
        routine = not text or found == before
        self._tell_of(t_ns, "diagnosis", address, text or "reads as in a bring-up", fields, routine=routine)
        self._messages(t_ns, address, diagnosis, device)

    def _messages(self, t_ns: int, address: int, diagnosis: Diagnosis, device: KnownDevice) -> None:
        """Alarms and status messages that the diagnosis before did not have."""
        blocks = frozenset(block.octets for block in diagnosis.blocks if isinstance(block, DeviceBlock))
        new, self._blocks[address] = blocks - self._blocks.get(address, frozenset()), blocks
        for octets in sorted(new) if device.dpv1 is not False else ():
            try:
                message = parse_block(octets)
            except PduError:
                continue
            fields = message_dict(message)
            if isinstance(message, Alarm):
                fields |= {"sequence": message.sequence, "user_ack": message.add_ack}
            kind = "alarm" if isinstance(message, Alarm) else "status_message"
            self._tell_of(t_ns, kind, address, full_text(message, first_slot_of(device.texts)), fields)

    def _tell_of(
        self,
        t_ns: int,
        kind: str,
        address: int,
        text: str,
        fields: Mapping[str, object],
        *,
        role: str = "station",
        routine: bool = False,
    ) -> None:
        """Tell something of the station ``address``; ``text`` goes on after its address and name."""
        station = self.counters.stations.get(address)
        name = self.devices.find(address, None if station is None else station.ident).name
        who = f"{role} {address} ({name})" if name else f"{role} {address}"
        self._tell(Happening(t_ns, kind, address, name, f"{who}: {text}", fields, routine))

    def _tell(self, happening: Happening) -> None:
        if not happening.routine:
            self.left_out += len(self.time_line) == TIME_LINE
            self.time_line.append(happening)
        self.on_event(happening)
