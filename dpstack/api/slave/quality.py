"""The quality of the process data of a slave at a moment: what its diagnosis, its inputs and their age say together."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from dpstack.api.config.slave import SlaveConfig
from dpstack.dp.doubts import ALL, ANNOUNCED, Doubt, DoubtKind, doubts_of, worst
from dpstack.dp.master.events import Fault, SlaveState
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.process_image import Value
from dpstack.dp.slave_params import SlaveParams
from dpstack.dp.slot_map import Direction
from dpstack.drivers.snapshots import ImageSnapshot, SlaveSnapshot
from dpstack.plant.items import DoubtValues, FaultValues, SlaveValues
from dpstack.plant.quality import Quality, Reason
from dpstack.plant.status_octet import read_octets
from dpstack.plant.value_quality import GOOD, Judged, trouble_of, worse
from dpstack.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from dpstack.dp.process_data import Field

#: stands with the time since which it holds, in ns by the clock of the bus
Standing = tuple[Doubt, int]

_REASONS: Final[dict[DoubtKind, Reason]] = {
    kind: Reason[kind.name] for kind in DoubtKind if kind is not DoubtKind.NO_PLACE
}


class Process(Protocol):
    """A slave as its judge sees it, see :class:`dpstack.api.slave.slave.Slave`."""

    config: SlaveConfig

    @property
    def setup(self) -> SlaveParams: ...
    @property
    def snapshot(self) -> SlaveSnapshot: ...
    @property
    def image(self) -> ImageSnapshot: ...
    @property
    def state(self) -> SlaveState: ...
    @property
    def ready_now(self) -> bool: ...
    @property
    def fault(self) -> Fault | None: ...
    @property
    def diagnosis(self) -> Diagnosis | None: ...
    @property
    def inputs_valid(self) -> bool: ...
    @property
    def inputs_age(self) -> float | None: ...
    @property
    def inputs_limit_ns(self) -> int: ...
    @property
    def process_quality(self) -> SlaveQuality: ...


class QualifiedValue(NamedTuple):
    """A named value with its quality, as :meth:`dpstack.api.slave.slave.Slave.value` gives it."""

    #: the value in the octets; the last one that arrived while the quality is stale
    value: Value
    #: good, uncertain, stale or bad
    quality: Quality
    #: the reason in words, fault first, then the place; empty for a good value without a remark
    text: str
    #: kind of the reason
    reason: Reason
    #: time since which the quality holds in ns by the clock of the bus; of a good value the arrival of its inputs
    since_ns: int
    #: what to do, if the diagnosis of the slave says why; else empty
    remedy: str = ""

    @property
    def good(self) -> bool:
        """Whether the value can be trusted as it is."""
        return self.quality is Quality.GOOD


class SlaveQuality:
    """Quality of all process data of ``slave``. Its doubts are read again only if the diagnosis is another one."""

    def __init__(self, slave: Process) -> None:
        self._slave = slave
        self._seen: object = None
        self._standing: tuple[Standing, ...] = ()
        #: qualities of single values by these doubts
        self._judged_for: tuple[Standing, ...] = ()
        self._places: dict[str, Judged] = {}

    @property
    def by_last_diagnosis(self) -> tuple[Standing, ...]:
        """The doubts by the last diagnosis and the alarms; none outside data exchange, where everything is old."""
        slave, snapshot, setup = self._slave, self._slave.snapshot, self._slave.setup
        if not slave.ready_now:
            self._seen, self._standing = None, ()
            return ()
        diagnosis = slave.diagnosis
        seen = diagnosis, snapshot.standing, setup, slave.config
        if seen != self._seen:
            self._seen = seen
            before = dict(self._standing)
            found = doubts_of(setup.slots, diagnosis, snapshot.standing, texts=setup.texts, dpv1=setup.has_messages)
            at = snapshot.diagnosis_ns
            self._standing = tuple((doubt, before.get(doubt, at)) for doubt in found)
        return self._standing

    @property
    def standing(self) -> tuple[Standing, ...]:
        """The doubts at this moment, also that of a diagnosis which is announced, or has not come yet."""
        found, image = self.by_last_diagnosis, self._slave.image
        if self._slave.ready_now and (image.announced or image.diagnoses > self._slave.snapshot.diagnoses):
            return ((ANNOUNCED, image.input_time), *found)
        return found

    def of_all(self, values: SlaveValues, limit_ms: float) -> Judged:
        """The quality of everything that the slave sends and gets. ``values``: its state and the age of its inputs;
        times in ns."""
        standing = self.standing
        of_all = {doubt: at for doubt, at in standing if doubt.inputs == ALL}
        by_slave = _judged(of_all)
        trouble = trouble_of(values, limit_ms)
        if trouble is None:
            return by_slave
        return worse(by_slave, Judged(*trouble, self._slave.image.input_time or None))

    def of_field(self, field: Field, octets: bytes, of_all: Judged, places: Mapping[str, Judged]) -> Judged:
        """The quality of a named value in ``octets``, with those of :meth:`of_all` and :meth:`places`."""
        own = places.get(field.name, GOOD)
        if field.speaks_for_itself:
            own = worse(own, _by_octets(field, octets, self._slave.image.input_time))
        return worse(own, of_all)

    def places(self) -> Mapping[str, Judged]:
        """The named values whose place the last diagnosis throws doubt on, not the whole slave."""
        standing = self.by_last_diagnosis
        if standing is not self._judged_for:
            self._judged_for = standing
            of_places = [(doubt, at) for doubt, at in standing if doubt.inputs != ALL]
            judged = (
                (
                    (name, _judged({doubt: at for doubt, at in of_places if doubt.is_about(field, direction)}))
                    for direction, fields in self._slave.config.fields
                    for name, field in fields.fields.items()
                )
                if of_places
                else ()
            )
            self._places = {name: one for name, one in judged if one is not GOOD}
        return self._places

    def by_diagnosis(self, *, announced: bool) -> Mapping[str, Judged]:
        """The named values that are not good by the last diagnosis alone; ``announced``: another one is."""
        found = self.by_last_diagnosis
        standing = ((ANNOUNCED, 0), *found) if announced else found
        of_all = _judged({doubt: at for doubt, at in standing if doubt.inputs == ALL})
        if of_all is GOOD:
            return self.places()
        names, places = (name for _, fields in self._slave.config.fields for name in fields), self.places()
        return {name: worse(places.get(name, GOOD), of_all) for name in names}

    def doubts(self) -> Iterator[DoubtValues]:
        """The doubts for people and for a rack view; times in ns."""
        for doubt, at in self.standing:
            place = None if bool(doubt.inputs) == bool(doubt.outputs) else "input" if doubt.inputs else "output"
            reason = _REASONS.get(doubt.kind, Reason.GOOD)
            yield DoubtValues(
                slot=doubt.slot,
                channel=doubt.channel,
                direction=place,
                quality=reason.quality.value,
                reason=reason.name.lower(),
                text=doubt.text,
                remedy=doubt.remedy,
                since=at,
            )


def _by_octets(field: Field, octets: bytes, at: int | None) -> Judged:
    """The quality by the value itself, and by the status octet beside it."""
    if len(octets) < max(field.octet + field.length, 0 if field.status is None else field.status + 1):
        return GOOD
    meaning = read_octets(field, octets)
    return GOOD if meaning.reason is Reason.GOOD else Judged(*meaning, at)


def _judged(standing: dict[Doubt, int]) -> Judged:
    found = worst(standing)
    return (
        GOOD
        if found is None or found.kind not in _REASONS
        else Judged(_REASONS[found.kind], found.text, standing[found], found.remedy)
    )


def judged_by(doubts: Iterable[Doubt], field: Field, direction: Direction, octets: bytes) -> Judged:
    """The quality of a named value in ``octets`` by these ``doubts``, with an unknown time."""
    by_diagnosis = _judged({doubt: 0 for doubt in doubts if doubt.is_about(field, direction)})
    return worse(_by_octets(field, octets, None), by_diagnosis)


def qualified(slave: Process, field: Field, direction: Direction) -> QualifiedValue:
    """A named value of ``slave`` with its quality at this moment."""
    image = slave.image
    octets = image.inputs if direction is Direction.INPUT else image.outputs
    quality = slave.process_quality
    age, limit_ms = slave.inputs_age, slave.inputs_limit_ns / NS_PER_MS
    fault = slave.fault
    values = SlaveValues(
        state=slave.state.value,
        inputs_valid=slave.inputs_valid,
        inputs_age_ms=None if age is None else age * 1000,
        fault=None if fault is None else FaultValues(fault.text, fault.kind.value),
    )
    judged = quality.of_field(field, octets, quality.of_all(values, limit_ms), quality.places())
    since = image.input_time if judged.since is None else round(judged.since)
    text = judged.reason.with_note(judged.note)
    return QualifiedValue(field.get(octets), judged.quality, text, judged.reason, since, judged.remedy)


def seconds(at_ns: float | None, started_ns: int) -> float | None:
    """A time in ns by the clock of the bus as s after its start, as the live stream has it; None: not known."""
    return None if at_ns is None or not at_ns else round(max(0.0, (at_ns - started_ns) / NS_PER_S), 3)
