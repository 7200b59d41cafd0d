"""Facts drawn from the evidence of one slave, each computed once: what its answers and its counters say, and what is
odd about its user parameters."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from dpstack.dp.acyclic.job import ATTEMPTS
from dpstack.dp.doubts import Doubt, doubts_of
from dpstack.dp.master.bring_ups import DAMAGED, DATA_EXCHANGE, NOTHING, WRONG, Loss, Step
from dpstack.dp.master.events import SlaveState
from dpstack.dp.master.scanner import Found
from dpstack.dp.master.verdicts import foreign_owner
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.dp.slave_params import OtherTelegram
from dpstack.errors import GsdError
from dpstack.fdl.interface import StationStats
from dpstack.fdl.telegram import StationType
from dpstack.gsd.model import in_ranges
from dpstack.gsd.module_comparison import Comparison, Difference, compare_modules
from dpstack.gsd.prm import UserPrm
from dpstack.params import DPV1_STATUS_LEN
from dpstack.units import BITS_PER_CHAR, NS_PER_MS, NS_PER_S, bits_to_ns
from dpstack.why.evidence import CLASS2, Evidence, Neighbour
from dpstack.why.steps import CHK_CFG, GET_CFG, REFUSALS, SET_PRM

#: requests from which a share of failures says something
ENOUGH: Final = 20
#: share of damaged answers from which a line is disturbed, and if there was only one
_DISTURBED: Final = 0.004
_ONCE: Final = 0.03
#: late answers, and their share of the failures, from which a slave is late
_LATE: Final = 2
_LATE_SHARE: Final = 0.05
#: a share of late answers that a busy computer makes
_RARE: Final = 0.002
#: failures from which their kind says something
_MISSING: Final = 6
#: share of unreadable answers among all, and their number, from which a second station is likelier than noise
_ALL_DAMAGED: Final = 0.85
_ALWAYS_DAMAGED: Final = 8
#: damaged octets from which missing answers are explained by them
_DROPPED: Final = 4
#: a state is out of date if the last good Data_Exchange is older than this many of the longest times between two
_STALE: Final = 4
#: share of the time that a station takes that sends without end, at least
_JAM_LOAD: Final = 0.4
_STALE_NS: Final = 200 * NS_PER_MS
#: a slave out of data exchange is asked again at least every second: after this time its state is of now
_ASKED_AGAIN_NS: Final = 1_200 * NS_PER_MS
#: slaves that fell silent within this time fell silent at once: one of them may be asked each second only
_AT_ONCE_NS: Final = 2 * NS_PER_S
#: a slave counts as steady after this long, and after this many times the longest time between two of its losses
_STEADY_NS: Final = 10 * NS_PER_S
_STEADY: Final = 3
#: losses from which a slave flaps
_FLAPS: Final = 2
#: user parameters named in a story at most
_SHOWN: Final = 4


def attempts(link: StationStats) -> int:
    return link.requests + link.retries


def failures(link: StationStats) -> int:
    """Attempts without an answer in time."""
    return link.retries + link.timeouts


def damaged(link: StationStats) -> int:
    """Attempts with octets that were no telegram, at most as many as failed."""
    return min(sum(link.bad.values()), failures(link))


def share(link: StationStats) -> float:
    return failures(link) / max(1, attempts(link))


def is_disturbed(link: StationStats, lost: int = 0) -> bool:
    """Octets that are no telegram came for the answers of a station: more often than on a good line, and not always.

    ``lost``: times it fell silent; a station that loses its power may break off in its answer.
    """
    harm = damaged(link) - lost
    return link.answers > 0 and harm >= 1 and harm >= (_DISTURBED if harm > 1 else _ONCE) * attempts(link)


def is_late(link: StationStats) -> bool:
    """Readable answers came when nobody waited for them any more: neither noise nor a missing station does that."""
    late, failed = link.late + link.wrong - link.early, failures(link)
    if late < _RARE * attempts(link):
        return False
    if late >= _LATE and late >= _LATE_SHARE * failed:
        return True
    return link.late - link.early >= 1 and failed >= _MISSING and 2 * damaged(link) <= failed


class Facts:
    """Facts about ``evidence``."""

    def __init__(self, evidence: Evidence) -> None:
        self.evidence = evidence
        self.setup = evidence.setup
        self.link = evidence.link
        self.neighbours = evidence.neighbours
        self.losses = evidence.history.losses
        self.lost = evidence.history.lost
        self.steps = evidence.steps

    @cached_property
    def doubts(self) -> tuple[Doubt, ...]:
        """What its last diagnosis throws doubt on."""
        setup = self.setup
        return doubts_of(setup.slots, self.diagnosis, texts=setup.texts, dpv1=setup.has_messages)

    # --- the last answers ---

    @cached_property
    def last_step(self) -> Step | None:
        return self.steps[-1] if self.steps else None

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """The newest diagnosis that the slave gave."""
        read = next((one for step in reversed(self.steps) if (one := step.diagnosis) is not None), None)
        # before the first diagnosis the master makes one up: Station_Non_Existent, ident 0
        known = self.evidence.history.idents or self.evidence.source == CLASS2
        return read or (self.evidence.diagnosis if known else None)

    def after(self, service: str) -> tuple[Step, ...]:
        """The steps behind the last ``service`` of the last bring-up that has one."""
        for up in reversed(self.evidence.history.bring_ups):
            for at in range(len(up.steps) - 1, -1, -1):
                if up.steps[at].asked == service:
                    return up.steps[at + 1 :]
        return ()

    def step_of(self, service: str) -> Step | None:
        """The last step of ``service``."""
        return next((step for step in self._newest_first if step.asked == service), None)

    @cached_property
    def _newest_first(self) -> tuple[Step, ...]:
        """The steps of all bring-ups."""
        return tuple(step for up in reversed(self.evidence.history.bring_ups) for step in reversed(up.steps))

    @cached_property
    def exchanging(self) -> bool:
        """In data exchange, by its master or by its diagnosis."""
        if self.evidence.source == CLASS2:
            found = self.diagnosis
            if found is None or found.master is None:
                return False
            return not (found.prm_req or found.not_ready or found.prm_fault or found.cfg_fault)
        return self.evidence.state is SlaveState.DATA_EXCHANGE and not self.stale

    @cached_property
    def stale(self) -> bool:
        """Its master is out of the ring, or has not exchanged data with it for long: its state is of the past."""
        evidence = self.evidence
        if not (evidence.ring.joined and evidence.ring.asks):
            return True
        age = evidence.now_ns - evidence.exchanged_ns
        limit = max(_STALE_NS, _STALE * evidence.line.longest_ns * self.setup.every)
        return bool(evidence.exchanged_ns) and evidence.source != CLASS2 and age > limit

    @cached_property
    def present(self) -> bool:
        """It answered at least once."""
        return bool(self.link.answers or self.link.late or self.evidence.history.idents or self.diagnosis is not None)

    @cached_property
    def answers_now(self) -> bool:
        """The last request was answered, or one of those that were asked now."""
        last = self.last_step
        return self._is_up or (last is not None and last.answered not in (NOTHING, DAMAGED))

    @cached_property
    def _is_up(self) -> bool:
        """It exchanges data, or has answered one of the requests of now."""
        return self.exchanging or any(step.answered not in (NOTHING, DAMAGED) for step in self.evidence.asked)

    @cached_property
    def silent_now(self) -> bool:
        """The last request was not answered, and nothing unreadable came either; nor was any that was asked now."""
        last = self.last_step
        if self._is_up:
            return False
        if last is None:
            return self.evidence.state is SlaveState.OFFLINE and not self.present and attempts(self.link) > 0
        return last.answered == NOTHING

    @cached_property
    def garbled_now(self) -> bool:
        """The last answers could not be read."""
        last = self.last_step
        return not self._is_up and last is not None and last.answered == DAMAGED

    @cached_property
    def mixed(self) -> bool:
        """Good, missing and unreadable answers come in turn."""
        kinds = {step.answered in (NOTHING, DAMAGED) for step in self.steps}
        return len(kinds) > 1 and any(step.answered == DAMAGED for step in self.steps)

    @cached_property
    def all_damaged(self) -> int:
        """The number of unreadable answers to the services of the last bring-up, if nearly all of them are; else 0.

        A class 2 service has several attempts.
        """
        weights = [
            (step.times * (ATTEMPTS if step in self.evidence.asked else 1), step.answered) for step in self.steps
        ]
        unreadable = sum(weight for weight, answered in weights if answered in (DAMAGED, WRONG))
        every = sum(weight for weight, _ in weights)
        return unreadable if unreadable >= _ALWAYS_DAMAGED and unreadable >= _ALL_DAMAGED * every else 0

    @cached_property
    def silent_polls(self) -> int:
        return sum(step.times for step in self.steps if step.answered == NOTHING)

    @cached_property
    def owner(self) -> int | None:
        """The other master that its newest diagnosis names."""
        return None if self.diagnosis is None else foreign_owner(self.diagnosis, self.evidence.ring.own)

    @cached_property
    def wrong_ident(self) -> int | None:
        """The ident number of another device at its address. A device that adapts is one if it refused to."""
        wanted = self.setup.ident
        if wanted is None or self.diagnosis is None or self.diagnosis.ident == wanted:
            return None
        if self.setup.ident_adapts and not self.is_fault("wrong_ident"):
            return None
        return self.diagnosis.ident

    @cached_property
    def is_elsewhere(self) -> bool:
        """A device with its ident is at the address of a slave that is configured with another one."""
        wanted = self.setup.ident
        return wanted is not None and any(one.found_ident == wanted != one.ident for one in self.neighbours)

    @cached_property
    def is_neighbour(self) -> bool:
        """The device at its address is one of those configured at other addresses."""
        return self.wrong_ident is not None and any(one.ident == self.wrong_ident for one in self.neighbours)

    @cached_property
    def waits_for_master(self) -> bool:
        """The right device wants parameters, and has refused none."""
        found = self.diagnosis
        if found is None or not found.prm_req or self.owner is not None or self.wrong_ident is not None:
            return False
        return not (found.prm_fault or found.cfg_fault or found.not_supported)

    # --- its losses ---

    @cached_property
    def lost_since(self) -> int:
        """Losses in the time that the counters cover."""
        if self.evidence.since_ns <= self.evidence.started_ns:
            return self.lost
        return sum(loss.t_ns >= self.evidence.since_ns for loss in self.losses)

    @cached_property
    def lost_silently(self) -> int:
        """Losses by silence after which it came back without parameters."""
        return sum(loss.how == NOTHING and bool(loss.back_ns) and loss.prm_req for loss in self.losses)

    @cached_property
    def lost_by_itself(self) -> int:
        """Losses in which it answered, and wanted parameters."""
        return sum(loss.how not in (NOTHING, DAMAGED) and loss.prm_req for loss in self.losses)

    @cached_property
    def lost_damaged(self) -> int:
        return sum(loss.how == DAMAGED for loss in self.losses)

    def steady_s(self, losses: Sequence[Loss]) -> float:
        """Seconds that it has been in data exchange since the last of ``losses``, if they are over; else 0."""
        last = self.evidence.bring_up
        if not self.exchanging or last is None or not last.exchanging_ns:
            return 0.0
        since = self.evidence.now_ns - last.exchanging_ns
        between = [b.t_ns - a.t_ns for a, b in itertools.pairwise(losses)]
        return since / NS_PER_S if since >= max(_STEADY_NS, *(_STEADY * one for one in between), 0) else 0.0

    @cached_property
    def flaps(self) -> bool:
        """It is in data exchange, has left it at least twice, and may do so again at any moment."""
        return self.exchanging and self.lost >= _FLAPS and not self.steady_s(self.losses)

    # --- the line ---

    @cached_property
    def silent_since(self) -> int:
        """Time of the first of the requests in a row that it has not answered; 0: none."""
        silent = itertools.takewhile(lambda step: step.answered == NOTHING, self._newest_first)
        return min((step.t_ns for step in silent), default=0)

    @cached_property
    def answering(self) -> tuple[Neighbour, ...]:
        """Slaves that answer now. A class 2 look does not know their states: there, those that answered in it."""
        looked = self.evidence.source == CLASS2
        return tuple(
            one for one in self.neighbours if (one.there and self._is_heard(one)) or (looked and one.link.answers)
        )

    @cached_property
    def unheard(self) -> tuple[Neighbour, ...]:
        """Slaves in data exchange that have not been asked since this one fell silent."""
        there = (one for one in self.neighbours if one.state is SlaveState.DATA_EXCHANGE)
        return tuple(one for one in there if not self._is_heard(one))

    def _is_heard(self, one: Neighbour) -> bool:
        """Whether the state of ``one`` is of the time since this slave fell silent: all may have, at once."""
        since = self.silent_since
        if not since or (one.state is SlaveState.DATA_EXCHANGE and not one.exchanged_ns):
            return True
        if one.state is SlaveState.DATA_EXCHANGE:
            return one.exchanged_ns > since
        return self.evidence.now_ns - since > _ASKED_AGAIN_NS

    @cached_property
    def silent_together(self) -> tuple[Neighbour, ...]:
        """The slaves that fell silent at the same moment as this one, if no slave answers since."""
        if not (self.present and self.silent_now) or self.anybody or self.unheard:
            return ()
        since = self.silent_since
        gone = (one for one in self.neighbours if one.link.answers and not one.there)
        return tuple(one for one in gone if not one.exchanged_ns or abs(since - one.exchanged_ns) < _AT_ONCE_NS)

    @cached_property
    def compared(self) -> tuple[Neighbour, ...]:
        """Slaves whose counters can be compared with those of this one: they answer, or have answered."""
        return tuple(one for one in self.neighbours if one.there or one.link.answers)

    @cached_property
    def others_found(self) -> tuple[Found, ...]:
        """Slaves that a scan found at other addresses."""
        own = self.setup.address
        return tuple(one for one in self.evidence.found or () if one.address != own and one.kind is StationType.SLAVE)

    @cached_property
    def strangers(self) -> tuple[Found, ...]:
        """Slaves at addresses that the configuration does not have."""
        known = {one.address for one in self.neighbours}
        return tuple(one for one in self.others_found if one.address not in known)

    @cached_property
    def anybody(self) -> bool:
        """Another slave answers."""
        return bool(self.answering or self.others_found)

    @cached_property
    def waits_help(self) -> bool:
        """Its answers to class 2 services are good if the master waits longer, and missing if it does not.

        The last attempt at such a service has more time. Nothing but a slow answer is healed by that.
        """
        good = sum(step.times for step in self.evidence.asked if step.answered == "DL")
        in_vain = self.evidence.asked_in_vain
        return good >= 2 and in_vain >= 2 * good and 4 * damaged(self.link) <= failures(self.link)

    @cached_property
    def disturbed_neighbours(self) -> tuple[Neighbour, ...]:
        if self.dropped_by_port:
            return tuple(one for one in self.neighbours if one.link.answers and failures(one.link))
        return tuple(one for one in self.neighbours if is_disturbed(one.link))

    @cached_property
    def marked(self) -> int:
        """Octets that the port has marked or counted as damaged, on the whole line."""
        bad = self.evidence.line.bad
        return max(bad.get("uart_marked", 0), bad.get("uart_parity", 0) + bad.get("uart_frame", 0))

    @cached_property
    def dropped_by_port(self) -> bool:
        """Answers are missing because the port drops damaged octets: on FTDI and PL2303 whole packets of them."""
        failed = failures(self.link)
        return bool(self.link.answers) and failed > 0 and self.marked >= max(_DROPPED, failed)

    @cached_property
    def damage(self) -> int:
        """Damaged telegrams, and octets outside of telegrams, on the whole line."""
        return sum(count for cause, count in self.evidence.line.bad.items() if cause not in ("skipped", "doubtful"))

    @cached_property
    def load(self) -> float:
        """The share of the time that unreadable octets take on the line."""
        line, seconds = self.evidence.line, max(1, self.evidence.now_ns - self.evidence.since_ns) / NS_PER_S
        octets = sum(count for cause, count in line.bad.items() if cause == "skipped" or cause.startswith("uart_"))
        return octets * BITS_PER_CHAR / line.baud / seconds

    @cached_property
    def foreign_rate(self) -> bool:
        """Nothing was ever understood, and the octets come with pauses, as from stations at another rate."""
        ring, line = self.evidence.ring, self.evidence.line
        return not (line.heard or ring.tokens or self.present) and self.load < _JAM_LOAD

    @cached_property
    def damage_here(self) -> int:
        return sum(self.link.bad.values())

    @cached_property
    def late_neighbours(self) -> tuple[Neighbour, ...]:
        """Slaves whose late answers fall into the exchanges of others."""
        return tuple(one for one in self.neighbours if is_late(one.link))

    @cached_property
    def superfluous(self) -> int:
        """Answers beyond the attempts that had none in time: from a second station."""
        return self.link.late + self.link.wrong - failures(self.link)

    # --- configuration, parameters, times ---

    @cached_property
    def real_config(self) -> bytes | None:
        """The identifier octets that the slave says to have; None if they are not known."""
        if self.evidence.config is not None:
            return self.evidence.config
        read = self.step_of(GET_CFG)
        return read.received if read is not None and read.received else None

    @cached_property
    def comparison(self) -> Comparison | None:
        """Wanted and real configuration; None if the real one is not known."""
        real = self.real_config
        if real is None:
            return None
        device, modules = self.evidence.device, self.evidence.modules
        first = 1 if device is None else device.first_slot
        return compare_modules(self.setup.config, real, device, modules, first)

    @cached_property
    def differs(self) -> bool:
        return self.comparison is not None and self.comparison.kind is not Difference.SAME

    @cached_property
    def other_telegram(self) -> OtherTelegram | None:
        """The drive has another telegram of its own than configured."""
        found, telegrams = self.real_config, self.setup.telegrams
        return None if found is None or telegrams is None else telegrams.other(found)

    @cached_property
    def modules_refused(self) -> bool:
        """It refuses Set_Prm and has other modules than configured: those that differ have user parameters, or it is a
        rack, which names what is plugged. A drive may name any telegram before Chk_Cfg."""
        found, device = self.comparison, self.evidence.device
        if not (self.prm_fault and self.differs) or found is None or device is None or self.wrong_ident is not None:
            return False
        if self.other_telegram is not None:
            return False
        differ = {part.octets for _, wanted, real in found.slots for part in (wanted, real) if part is not None}
        is_rack = device.modular and len(found.real) > 1 and all(part.title for part in found.real)
        return is_rack or any(module.prm.present for module in device.modules if module.config in differ)

    @cached_property
    def parameters(self) -> ParameterFacts:
        """The facts about the user parameters of the slave, as its configuration has them."""
        setup, expected = self.setup, self.evidence.expected_prm
        sent, dpv1 = setup.user_octets(None), setup.dpv1 is not None
        if expected is None:
            return ParameterFacts(sent, dpv1=dpv1)
        wanted = len(expected) + len(sent) - len(setup.user_prm)
        if len(setup.user_prm) != len(expected):
            return ParameterFacts(sent, wanted, dpv1=dpv1)
        return ParameterFacts(sent, wanted, *_named(self.evidence, expected), dpv1)

    @cached_property
    def cfg_fault(self) -> bool:
        return any(found.cfg_fault for found in self._refusing(CHK_CFG)) or self._kind == "cfg_fault"

    @cached_property
    def prm_fault(self) -> bool:
        return any(found.prm_fault for found in self._refusing(SET_PRM)) or self._kind == "prm_fault"

    @cached_property
    def not_supported(self) -> bool:
        return any(found.not_supported for found in self._refusing(SET_PRM)) or self._kind == "not_supported"

    @cached_property
    def _kind(self) -> str:
        fault = self.evidence.fault
        return "" if fault is None else fault.kind.value

    def is_fault(self, *kinds: str) -> bool:
        """Whether the fault of the slave is one of ``kinds``."""
        return self._kind in kinds

    def _refusing(self, service: str) -> Iterable[Diagnosis]:
        """Diagnoses after ``service`` of this master; on a bus that was only looked at, the newest one."""
        if self.evidence.source == CLASS2:
            return () if self.diagnosis is None else (self.diagnosis,)
        return self.diagnoses_after(service)

    def diagnoses_after(self, service: str) -> tuple[Diagnosis, ...]:
        return tuple(one for step in self.after(service) if (one := step.diagnosis) is not None)

    @cached_property
    def silent_after_prm(self) -> bool:
        """It answered before Set_Prm and acknowledged it, or was silent then, and is silent since."""
        step = self.step_of(SET_PRM)
        if step is None or not self.evidence.history.idents:
            return False
        later = self.after(SET_PRM)
        if self.evidence.history.brought_up or not later:
            return False
        return all(one.answered == NOTHING for one in later) and sum(one.times for one in later) > 0

    @cached_property
    def slot_ns(self) -> int:
        return bits_to_ns(self.evidence.line.slot_bits, self.evidence.line.baud)

    @cached_property
    def watchdog_ms(self) -> float:
        return self.evidence.watchdog_ns / NS_PER_MS

    @cached_property
    def wrong_data(self) -> Step | None:
        """A Data_Exchange that brought another number of octets than configured."""
        good = ("DL", "DH", "SC", "OK")
        found = (step for step in self._newest_first if step.asked == DATA_EXCHANGE and step.answered in good)
        return next((step for step in found if len(step.received) != self.setup.input_len), None)

    def refused(self, *services: str) -> Step | None:
        """The last step of ``services`` that was refused with RS, RR or UE again and again."""
        found = (step for step in self._newest_first if step.asked in services)
        return next((step for step in found if step.answered in REFUSALS), None)


# --- user parameters held against the GSD file ---


@dataclass(frozen=True, slots=True)
class ParameterFacts:
    """``sent``: octets behind the seven fixed ones. ``wanted``: their number by the GSD file, None: not known.

    ``impossible``: sentences about values that the file excludes; ``changed``: about values that are not the file's
    own; ``dpv1``: the slave is parameterised for DP-V1. ``only_status``: there is nothing behind DPV1_Status.
    """

    sent: bytes
    wanted: int | None = None
    impossible: tuple[str, ...] = ()
    changed: tuple[str, ...] = ()
    dpv1: bool = False

    @property
    def only_status(self) -> bool:
        return self.dpv1 and len(self.sent) == DPV1_STATUS_LEN

    @property
    def wrong_length(self) -> bool:
        return self.wanted is not None and len(self.sent) != self.wanted


def _named(evidence: Evidence, expected: bytes) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """``impossible`` and ``changed`` of :class:`ParameterFacts`."""
    setup = evidence.setup
    impossible: list[str] = []
    changed: list[str] = []
    covered: set[int] = set()
    with contextlib.suppress(GsdError):
        if evidence.device is not None:
            prm = UserPrm(evidence.device, evidence.modules)
            for own, usual in zip(prm.read(setup.user_prm), prm.read(expected), strict=True):
                covered |= set(range(own.at, own.at + own.parameter.type.size))
                where = f"Octet {SET_PRM_LEN + 1 + own.at} of Set_Prm, {own.parameter.name!r}"
                low, high = own.parameter.type.limits
                if not (low <= own.value <= high and in_ranges(own.value, own.parameter.allowed)):
                    impossible.append(f"{where}: {own.value} is not allowed by the GSD file.")
                elif own.value != usual.value:
                    changed.append(f"{where}: {own.text} instead of the default {usual.text}.")
    has_status = setup.dpv1 is not None or (evidence.device is not None and evidence.device.dpv1.slave)
    status = DPV1_STATUS_LEN if has_status or setup.fail_safe_told or setup.wd_base_1ms else 0
    for at, (octet, default) in enumerate(zip(setup.user_prm, expected, strict=True)):
        if octet != default and at not in covered and at >= status:
            where = f"Octet {SET_PRM_LEN + 1 + at} of Set_Prm"
            changed.append(f"{where}: {octet:02X}, the GSD file has {default:02X}.")
    return tuple(impossible[:_SHOWN]), tuple(changed[:_SHOWN])
