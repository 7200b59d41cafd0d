"""Causes of a slave that is not in data exchange, each with what speaks for and against it.

Each rule looks at one group of causes. A confidence of 0.9 and more stands only if the protocol leaves no other
explanation for the answers: an ident number, a master's address, a configuration that the slave itself names.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Final

from dpstack.dp.doubts import Trust
from dpstack.dp.master.bring_ups import DATA_EXCHANGE, NOTHING, SLAVE_DIAG
from dpstack.dp.master.events import SlaveState
from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.gsd.module_comparison import Difference
from dpstack.text import octets_text, some_of, times_text
from dpstack.units import NS_PER_S, baud_text, ms_text
from dpstack.why.causes import Cause
from dpstack.why.evidence import CLASS2, PublisherLink
from dpstack.why.facts import ENOUGH, Facts, attempts, damaged, failures, is_disturbed, is_late, share
from dpstack.why.steps import CHK_CFG, SET_PRM, hex_text

#: damaged octets and telegrams on a line that nobody can use
_JAMMED: Final = 40
#: answers in a row of two devices
_ALTERNATING: Final = 2
#: waiting time after Chk_Cfg from which a slave counts as not ready
_READY_NS: Final = NS_PER_S
#: min T_SDR in Set_Prm that every slave can have
_USUAL_MIN_TSDR: Final = 11


@dataclass(frozen=True, slots=True)
class Finding:
    """One cause with a confidence 0..1 and sentences. ``next``: empty for the usual next step of the cause;
    ``meaning``: likewise. The slave's fault has the same words, if it names the cause."""

    cause: Cause
    confidence: float
    speaks_for: list[str] = field(default_factory=list)
    against: list[str] = field(default_factory=list)
    next: str = ""
    meaning: str = ""

    def less(self, confidence: float, why: str = "") -> Finding:
        """The finding with at most ``confidence``, and ``why`` against it."""
        more = [why] if why else []
        return replace(self, confidence=min(self.confidence, confidence), against=[*self.against, *more])


Findings = Iterator[Finding]


def judge(facts: Facts) -> list[Finding]:
    """All findings, the likeliest first; "healthy" if nothing speaks against the slave."""
    found: dict[Cause, Finding] = {}
    for rule in _RULES:
        for finding in rule(facts):
            before = found.get(finding.cause)
            if before is None or before.confidence < finding.confidence:
                found[finding.cause] = finding
    findings = _weighed(facts, list(found.values()))
    findings += _healthy(facts, findings)
    return sorted(findings, key=lambda one: -one.confidence)


def _weighed(f: Facts, found: list[Finding]) -> list[Finding]:
    """Weaken what another finding explains as well: a slave that could not be asked is not known to be away."""
    causes = {one.cause: one.confidence for one in found}
    of_bus = max((causes.get(cause, 0.0) for cause in _OF_BUS), default=0.0)
    weighed = []
    for one in found:
        if Cause.ANOTHER_PROGRAM in causes and one.cause is not Cause.ANOTHER_PROGRAM:
            one = one.less(0.4, "Another program at the port explains this, too.")
        if one.cause in _BY_BUS and of_bus >= 0.7:
            one = one.less(0.3, "The master could hardly ask: the bus itself has a fault.")
        noise = max(causes.get(Cause.NOISE_ON_STUB, 0.0), causes.get(Cause.NOISE_ON_SEGMENT, 0.0))
        if one.cause in (Cause.REBOOTS, Cause.NOT_THERE, Cause.WATCHDOG_SHORT, Cause.MIN_TSDR) and noise >= 0.7:
            one = one.less(0.5, "Its answers are disturbed: requests and answers get lost by that, too.")
        if one.cause is Cause.NOT_THERE and causes.get(Cause.WRONG_ADDRESS, 0.0) >= 0.6:
            one = one.less(0.45, "A station with its ident answers at another address.")
        if one.cause is Cause.REBOOTS and max((causes.get(cause, 0.0) for cause in _OF_NOW), default=0.0) >= 0.6:
            one = one.less(0.4, "Another cause explains why it is not in data exchange now.")
        if one.cause is Cause.NOISE_ON_STUB and causes.get(Cause.DUPLICATE_ADDRESS, 0.0) >= 0.7:
            one = one.less(0.5, "Noise leaves some answers readable.")
        weighed.append(one)
    return weighed


_OF_BUS: Final = (Cause.NO_TOKEN, Cause.SECOND_MASTER_SAME_ADDRESS, Cause.BUS_JAMMED)
#: reported by the slave itself, or by the device that stands elsewhere: restarts before it say nothing about now
_OF_NOW: Final = (
    Cause.WRONG_ADDRESS,
    Cause.IDENT,
    Cause.MODULE_ORDER,
    Cause.MODULE_MISSING,
    Cause.MODULE_EXTRA,
    Cause.MODULE_TYPE,
    Cause.USER_PARAMETER,
    Cause.USER_PARAMETER_LENGTH,
    Cause.DPV1_MISMATCH,
    Cause.NOT_SUPPORTED,
    Cause.ISOCHRONOUS,
    Cause.LOCKED,
)
#: explained by a fault of the bus
_BY_BUS: Final = (
    Cause.NOT_THERE,
    Cause.ALL_SILENT,
    Cause.NOISE_ON_STUB,
    Cause.NOISE_ON_SEGMENT,
    Cause.REBOOTS,
    Cause.WATCHDOG_SHORT,
    Cause.DUPLICATE_ADDRESS,
)


# --- the master and the ring ------------------------------------------------------------------------------------------


def _deactivated(f: Facts) -> Findings:
    if f.evidence.state is SlaveState.DEACTIVATED:
        yield Finding(Cause.DEACTIVATED, 0.99, ["The application took it out of service by deactivate()."])


def _another_program(f: Facts) -> Findings:
    """The port itself is disturbed: no station on the bus explains that."""
    if f.evidence.line.disturbed and not f.exchanging:
        yield Finding(Cause.ANOTHER_PROGRAM, 0.88, [f"Seen at the port: {f.evidence.line.disturbed}."])


def _ring(f: Facts) -> Findings:
    ring, line = f.evidence.ring, f.evidence.line
    if ring.collision:
        said = f"Telegrams with this master's own address {ring.own} came that it has not sent: {ring.collision}."
        yield Finding(Cause.SECOND_MASTER_SAME_ADDRESS, 0.88, [said])
    jammed = f.damage >= _JAMMED and f.damage > line.heard // 4 and not f.foreign_rate
    if jammed and not f.exchanging:
        yield _jam(f)
    if f.exchanging or ring.collision:
        return
    if not ring.joined:
        yield from _out_of_ring(f, jammed=jammed)
    elif not ring.asks:
        todo = "operate() or clear(): the master sends nothing to slaves in Stop"
        yield Finding(Cause.NO_TOKEN, 0.85, ["The master is in Stop: it asks no slave."], next=todo)
    elif f.evidence.source == CLASS2 and f.waits_for_master:
        yield _masterless(f)
    elif not (ring.tokens or attempts(f.link) or f.steps or f.evidence.read_only):
        facts = ["This master was not given the token so far, so it has asked nobody."]
        yield Finding(Cause.NO_TOKEN, 0.8, facts, next="run longer; then look at HSA and the GAP of the other masters")


def _masterless(f: Facts) -> Finding:
    """The slave waits for parameters, and no master has it."""
    ring = f.evidence.ring
    said = ["The slave answers and waits for parameters (Prm_Req), and no master has it."]
    if ring.own == f.evidence.asker:
        return Finding(Cause.NO_TOKEN, 0.8, said, next="start its master; its configuration must have this slave")
    if ring.own not in ring.masters:
        said.append(f"No master {ring.own} is in the token ring: nobody brings the slave up.")
        return Finding(
            Cause.NO_TOKEN, 0.85, said, next=f"start master {ring.own}: `dpstack run` with this configuration"
        )
    said.append(f"Master {ring.own} is in the token ring, and has not parameterised it (yet).")
    return Finding(
        Cause.NO_TOKEN, 0.4, said, next=f"look at master {ring.own}: does its configuration have this slave?"
    )


def _jam(f: Facts) -> Finding:
    ring, line = f.evidence.ring, f.evidence.line
    said = [f"{f.damage} damaged telegrams and octets outside of telegrams came, {line.heard} readable telegrams."]
    if ring.tokens_lost:
        said.append(f"The token was lost {times_text(ring.tokens_lost)}.")
    if not ring.joined:
        said.append("The master is out of the ring: the line is never quiet long enough for it.")
        return Finding(Cause.BUS_JAMMED, 0.87 if f.damage > line.heard else 0.7, said)
    others = [one.name for one in f.answering if one.state is SlaveState.DATA_EXCHANGE]
    if others:
        return Finding(Cause.BUS_JAMMED, 0.3, said, [f"Others are in data exchange: {some_of(others)}."])
    sure = 0.8 if f.damage > 10 * line.heard or ring.tokens_lost > 2 else 0.6
    return Finding(Cause.BUS_JAMMED, sure, said)


def _out_of_ring(f: Facts, *, jammed: bool) -> Findings:
    ring, line = f.evidence.ring, f.evidence.line
    others = sorted(ring.masters - {ring.own})
    said = [f"The master (address {ring.own}) is not in the token ring."]
    if ring.refused:
        said.append(f"Joining failed: {ring.refused}.")
    if others:
        said.append(f"Masters in the ring, by address: {', '.join(map(str, others))}.")
    waited = f.evidence.now_ns - f.evidence.started_ns
    unreadable = not (line.heard or ring.tokens or others) and waited > _CLAIMS * f.slot_ns
    if unreadable:  # a silent line would have been claimed
        why = [
            f"Nothing could be read at {baud_text(line.baud)} in {waited / NS_PER_S:.1f} s.",
            "The line is not silent, else the master would have claimed the token.",
            "Another master at another rate looks like this.",
        ]
        if f.damage:
            why.append(f"{f.damage} octets came that are no telegrams, with pauses: {f.load:.0%} of the time.")
        yield Finding(Cause.RATE_MISMATCH, 0.5 if jammed else 0.8, why)
    against = ["No other master was understood."] if unreadable else []
    yield Finding(Cause.NO_TOKEN, 0.5 if jammed or unreadable else 0.86, said, against)


#: T_TO in slot times of the highest address is 6 + 2 x 126; after this many a silent line is claimed for sure
_CLAIMS: Final = 2 * (6 + 2 * 126)


# --- nobody answers ---------------------------------------------------------------------------------------------------


def _absent(f: Facts) -> Findings:
    if not f.silent_now:
        return
    setup, line = f.setup, f.evidence.line
    polls = f.silent_polls or failures(f.link)
    said = [f"Address {setup.address} did not answer {polls} requests in a row at {baud_text(line.baud)}."]
    against = []
    if f.present:
        said.append("It has answered before: it was there at this rate and address, so look at power and wiring first.")
    if f.evidence.rates and line.baud not in f.evidence.rates:
        rates = ", ".join(baud_text(rate) for rate in sorted(f.evidence.rates))
        said.append(f"By its GSD file it does not know {baud_text(line.baud)}, only {rates}.")
    confidence = 0.7
    if f.answering:
        said.append(f"Others answer at this rate: {some_of(one.name for one in f.answering)}.")
        confidence = 0.88
    elif f.others_found:
        said.append(f"Others answer at this rate: {some_of(str(one.address) for one in f.others_found)}.")
        confidence = 0.85
    elif f.evidence.found is not None:
        against.append("No other station answers either: a common cause is likelier.")
        confidence = 0.6
    todo = ""
    if f.silent_together:
        yield from _all_silent(f)
        against.append("Other slaves fell silent at the same moment.")
        confidence = 0.5
    elif f.present and f.neighbours and not (f.anybody or f.unheard):
        said.append("No other slave of the configuration answers now.")
    if f.evidence.found is None and f.evidence.unknown:
        places = some_of(map(str, sorted(f.evidence.unknown)))
        said.append(f"Address {places} answers, and no slave is configured there: has the device that address?")
        todo = f"read address {places} with `dpstack diag`: is it this device? {Cause.NOT_THERE.about.next}"
    if f.evidence.found is not None and not f.strangers and f.anybody:
        said.append("A scan found no unknown station, so it has no other address on this segment.")
    if is_late(f.link) or f.superfluous >= 3:
        against.append(f"{f.link.late + f.link.wrong} answers of it came when nobody waited for them.")
        confidence = 0.3
    if f.lost_silently >= 2:
        against.append(f"It came back {times_text(f.lost_silently)} before.")
        confidence = 0.55
    if f.damage_here > polls // 2:
        against.append("Octets that cannot be read came after requests to it.")
        confidence = min(confidence, 0.45)
    if f.marked and f.lost:  # it was there, and its answers may be among the octets that the port drops
        damaged_text = f"The port has marked or dropped {f.marked} damaged octets: an answer may have been among them."
        against.append(damaged_text)
        confidence = min(confidence, 0.45)
        yield Finding(Cause.NOISE_ON_STUB, 0.5, [damaged_text])
    if f.silent_after_prm and not f.lost:
        against.append("It answered until it was parameterised.")
        confidence = min(confidence, 0.5)
    yield Finding(Cause.NOT_THERE, confidence, said, against, todo)
    if not f.anybody and not f.present:
        yield from _nobody(f)


def _all_silent(f: Facts) -> Findings:
    together = len(f.silent_together) + 1
    said = [f"{together} slaves fell silent at the same moment, and no other one answers."]
    if together == len(f.neighbours) + 1:
        said = [f"All {together} slaves of the configuration are silent at once."]
    yield Finding(Cause.ALL_SILENT, 0.85, said)


def _nobody(f: Facts) -> Findings:
    line, many = f.evidence.line, len(f.neighbours)
    said = [f"Nobody answers at {baud_text(line.baud)}."]
    confidence = 0.45
    if many:
        said.append(f"All {many + 1} slaves of the configuration are silent at once.")
        confidence = 0.8
    if f.evidence.found is not None:
        said.append("A scan of all addresses found no slave.")
        confidence += 0.05
    if f.damage:
        said.append(f"{f.damage} octets came that are no telegrams at this rate.")
        confidence = max(confidence, 0.7)
    others = sorted(f.evidence.ring.masters - {f.evidence.ring.own})
    against = []
    if others:
        against.append(f"Masters {', '.join(map(str, others))} are understood at this rate.")
        confidence = 0.35
    if f.compared:
        against.append(f"{some_of(one.name for one in f.compared)} answered at this rate before.")
        confidence = 0.35
    yield Finding(Cause.RATE_MISMATCH, confidence, said, against)


def _elsewhere(f: Facts) -> Findings:
    """A station with its ident at an address that is not meant for one."""
    wanted = f.setup.ident
    if wanted is None or f.exchanging or (f.answers_now and f.wrong_ident is None):
        return
    if not (f.silent_now or f.wrong_ident is not None):
        return
    meant = {one.address for one in f.neighbours if one.ident == wanted}
    yield from _swapped(f, wanted)
    there = [one for one in f.others_found if one.ident == wanted and one.address not in meant]
    if not there:
        return
    places = ", ".join(str(one.address) for one in there)
    said = [f"A station with its ident 0x{wanted:04X} answers at address {places}; no such device is configured there."]
    if any(one.config == f.setup.config for one in there):
        said.append("That station has the configured modules, too.")
    against = []
    confidence = 0.88
    owned = [one for one in there if one.master not in (None, f.evidence.ring.own)]
    if len(owned) == len(there):
        against.append(f"That station belongs to master {owned[0].master}.")
        confidence = 0.5
    todo = f"set the address of the device at {places} to {f.setup.address}: its switches, or `dpstack address`"
    yield Finding(Cause.WRONG_ADDRESS, confidence, said, against, todo)


def _swapped(f: Facts, wanted: int) -> Findings:
    """The device is at the address of another slave of the configuration."""
    for one in f.neighbours:
        if one.found_ident != wanted or one.ident in (wanted, None):
            continue
        place = f"{one.address} ({one.name})"
        said = [f"The device at address {place} has the ident 0x{wanted:04X} that is configured here."]
        todo = f"set the address of the device at {place} to {f.setup.address}"
        if f.wrong_ident == one.ident:
            said.append(f"The device here has the ident 0x{one.ident:04X} that is configured there.")
            yield Finding(Cause.WRONG_ADDRESS, 0.93, said, next=f"exchange the addresses {f.setup.address} and {place}")
        else:
            yield Finding(Cause.WRONG_ADDRESS, 0.85, said, next=f"{todo}, or correct address in the configuration")


def _ident(f: Facts) -> Findings:
    if f.wrong_ident is None or f.setup.ident is None:
        return
    said = [
        f"Its diagnosis says ident 0x{f.wrong_ident:04X} (octets 5 and 6), the configuration 0x{f.setup.ident:04X}."
    ]
    if f.setup.ident_adapts:
        said.append("It did not adapt its ident number to the one in Set_Prm.")
    against = []
    confidence = 0.96
    if _alternates(f):
        against.append("The right ident came, too: two devices answer in turn.")
        confidence = 0.4
    elif f.setup.ident in f.evidence.history.idents:
        said.append("The right ident came before: the device was exchanged.")
        confidence = 0.8
    if any(one.ident == f.setup.ident for one in f.strangers) or f.is_elsewhere:
        confidence = min(confidence, 0.6)
    yield Finding(Cause.IDENT, confidence, said, against)


def _alternates(f: Facts) -> bool:
    """Whether diagnoses of two devices came in turn."""
    if f.setup.ident_adapts:
        return False
    idents = [one.ident for step in f.steps if (one := step.diagnosis) is not None]
    changes = sum(a != b for a, b in itertools.pairwise(idents))
    return changes >= _ALTERNATING


# --- two stations, noise, late answers --------------------------------------------------------------------------------


def _doubled(f: Facts) -> Findings:
    said, confidence = [], 0.0
    address = f.setup.address
    if _alternates(f):
        idents = " and ".join(f"0x{one:04X}" for one in f.evidence.history.idents[:3])
        said.append(f"Diagnoses of two devices came in turn from address {address}: ident {idents}.")
        confidence = 0.89
    if f.all_damaged:
        said.append(f"Answers came, and {f.all_damaged} of them could not be read: nearly all.")
        confidence = max(confidence, 0.82 if f.anybody or not f.neighbours else 0.5)
    elif address in f.evidence.unreadable:
        said.append("The scan got an answer from it that could not be read.")
        confidence = max(confidence, 0.6)
    if f.superfluous >= ENOUGH // 2:
        said.append(f"It gave {f.superfluous} more answers than it had requests that were not answered in time.")
        confidence = max(confidence, 0.85)
    if not confidence:
        return
    against = []
    if f.disturbed_neighbours:
        against.append(f"Answers of {some_of(one.name for one in f.disturbed_neighbours)} are damaged, too.")
        confidence = min(confidence, 0.55)
    yield Finding(Cause.DUPLICATE_ADDRESS, confidence, said, against)


def _retried(f: Facts) -> bool:
    """Answers of the slave are missing now and then, more often than its losses explain."""
    retried = f.link.retries - 3 * f.lost_since
    return f.link.answers > 0 and retried >= 4 and retried >= 0.004 * attempts(f.link)


def _noise(f: Facts) -> Findings:
    link = f.link
    harmed = is_disturbed(link, f.lost_since) or (f.mixed and damaged(link) > f.lost_since) or f.dropped_by_port
    if not (harmed or (_retried(f) and not f.exchanging and not f.silent_together)):
        yield from _noise_of_others(f)
        return
    said = [f"{failures(link)} of {attempts(link)} requests had no good answer, {damaged(link)} of them a damaged one."]
    lost = [f"It was lost {times_text(f.lost)} by that."] if f.lost_damaged else []
    if f.dropped_by_port:
        said.append(f"The port has dropped {f.marked} octets with a parity or framing error: answers came, damaged.")
        lost = [f"It was lost {times_text(f.lost)} by that."] if f.lost else []
    most = 0.87
    against = []
    if not harmed:
        against.append("No damaged octets came, answers are only missing.")
        most = 0.5
    if is_late(link) or f.waits_help:
        against.append("Its answers come late, and late answers run into other telegrams.")
        most = min(most, 0.4)
    if f.late_neighbours:
        names = some_of(one.name for one in f.late_neighbours)
        against.append(f"Late answers of {names} run into other telegrams.")
        most = min(most, 0.5)
    bad = f.disturbed_neighbours
    clean = [one for one in f.answering if one not in bad]
    tokens = f.evidence.ring.token_retries
    if tokens >= 3:
        said.append(f"The token had to be sent again {tokens} times.")
    too = [f"Answers of {some_of(one.name for one in bad)} are damaged, too."] if bad else []
    quiet = [f"Others are undisturbed: {some_of(one.name for one in clean)}."] if clean else []
    if bad and len(bad) >= len(clean):
        yield Finding(Cause.NOISE_ON_SEGMENT, most, [*said, *too, *lost], [*against, *quiet])
        yield Finding(Cause.NOISE_ON_STUB, min(0.3, most), said, [*against, *too])
    elif bad:
        yield Finding(Cause.NOISE_ON_STUB, min(0.6, most), [*said, *quiet, *lost], [*against, *too])
        yield Finding(Cause.NOISE_ON_SEGMENT, min(0.5, most), [*said, *too], [*against, *quiet])
    elif clean:
        yield Finding(Cause.NOISE_ON_STUB, most, [*said, *quiet, *lost], against)
        yield Finding(Cause.NOISE_ON_SEGMENT, min(0.15, most), said, [*against, *quiet])
    else:
        alone = ["No other slave answers to compare it with."]
        yield Finding(Cause.NOISE_ON_STUB, min(0.6, most), [*said, *lost], [*against, *alone])
        yield Finding(Cause.NOISE_ON_SEGMENT, min(0.65 if tokens >= 3 else 0.5, most), said, against)


def _noise_of_others(f: Facts) -> Findings:
    """Most others are disturbed, and requests to this slave failed, too."""
    bad = f.disturbed_neighbours
    if failures(f.link) and bad and 2 * len(bad) >= len(f.compared) and not (f.late_neighbours or is_late(f.link)):
        said = [f"Answers of {some_of(one.name for one in bad)} are damaged."]
        missing = f"{failures(f.link)} of {attempts(f.link)} requests to this slave had no good answer."
        yield Finding(Cause.NOISE_ON_SEGMENT, 0.5, [*said, missing], ["Its own answers are not damaged."])


def _late(f: Facts) -> Findings:
    link, slot = f.link, f.evidence.line.slot_bits
    late = link.late + link.wrong - link.early
    min_tsdr = f.setup.min_tsdr
    slow = min_tsdr > slot - _USUAL_MIN_TSDR
    begins = f"min_tsdr is {min_tsdr} bit times, the slot time (T_SL) {slot}."
    if link.early >= 2 and link.early >= 0.3 * failures(link):
        bits = f.evidence.line.min_tsdr
        said = [f"{link.early} of its answers began before min T_SDR, which this bus has at {bits} bit times."]
        if bits > min_tsdr:
            said.append(f"Set_Prm gives the slave min T_SDR {min_tsdr}: it may answer after that time.")
        yield Finding(Cause.MIN_TSDR, 0.89, said)
    if is_late(link) and f.superfluous < ENOUGH // 2 and not f.all_damaged:
        said = [f"{late} of its answers came after the slot time of {slot} bit times ({ms_text(f.slot_ns)})."]
        against = [begins + " The answers are late by order of the master."] if slow else []
        if 2 * damaged(link) <= failures(link):
            said.append("Most of its missing answers left no damaged octets.")
        limit = f.setup.max_tsdr.get(f.evidence.line.baud)
        if limit is not None and limit >= slot:
            said.append(f"Its GSD file says max_Tsdr = {limit} bit times at this rate.")
        yield Finding(Cause.ANSWERS_LATE, 0.5 if slow else 0.87, said, against)
    elif f.waits_help and not f.all_damaged and not link.early:
        said = [
            f"It answers if the master waits longer than the slot time of {slot} bit times ({ms_text(f.slot_ns)}), "
            f"and {f.evidence.asked_in_vain} attempts with the slot time alone had no answer."
        ]
        yield Finding(Cause.ANSWERS_LATE, 0.8, said)
    if slow and not f.exchanging and (f.silent_after_prm or late >= 3):
        said = [begins, "It answers before Set_Prm, and too late or not at all after it."]
        yield Finding(Cause.MIN_TSDR, 0.91, said)
    elif f.silent_after_prm and not is_late(link) and not link.early:
        said = ["It answered Slave_Diag before Set_Prm, and nothing after it."]
        odd = min_tsdr != _USUAL_MIN_TSDR
        said += [f"min_tsdr in Set_Prm is {min_tsdr} bit times, not the usual {_USUAL_MIN_TSDR}."] if odd else []
        yield Finding(Cause.MIN_TSDR, 0.75 if odd else 0.45, said)
        yield Finding(Cause.REBOOTS, 0.4, [*said, "A device that restarts at each Set_Prm looks the same."])


# --- parameters and configuration ------------------------------------------------------------------------------------


def _locked(f: Facts) -> Findings:
    if f.owner is None:
        return
    ring = f.evidence.ring
    said = [f"Octet 4 of its diagnosis names master {f.owner}; this master is {ring.own}."]
    if f.owner in ring.masters:
        said.append(f"Master {f.owner} is in the token ring.")
        yield Finding(Cause.LOCKED, 0.96, said)
        return
    diagnosis = f.diagnosis
    watched = diagnosis is not None and diagnosis.wd_on
    said.append(f"Master {f.owner} is not in the token ring (any more), and the slave still belongs to it.")
    todo = (
        "wait until its watchdog gives it free, or switch it off and on"
        if watched
        else f"its watchdog is off: switch it off and on, or let master {f.owner} end in order"
    )
    yield Finding(Cause.LOCKED, 0.92, said, next=todo)


def _isochronous(f: Facts) -> Findings:
    fault = f.evidence.fault
    if fault is not None and f.is_fault("isochronous"):
        yield Finding(Cause.ISOCHRONOUS, 0.98, [f"The master does not parameterise it: it {fault.message}."])


def _parameters(f: Facts) -> Findings:
    if f.not_supported:
        asked = [word for word, on in (("SYNC", f.setup.sync), ("FREEZE", f.setup.freeze)) if on]
        said = ["Its diagnosis says Not_Supported (octet 1 bit 4) after Set_Prm."]
        said += [f"Set_Prm asks for {' and '.join(asked)} (octet 1)."] if asked else []
        yield Finding(Cause.NOT_SUPPORTED, 0.95, said)
    silent = _drops(f, SET_PRM)
    if f.exchanging or f.wrong_ident is not None or f.owner is not None or not (f.prm_fault or silent):
        return
    known = f.parameters
    begin = (
        ["It refuses Set_Prm: Prm_Fault (octet 1 bit 6 of its diagnosis); the ident in it is right."]
        if f.prm_fault
        else ["It never acknowledges Set_Prm, and answers Slave_Diag: some devices drop what they cannot accept."]
    )
    if f.diagnosis is not None and f.diagnosis.ext:
        texts_of = "".join(f"; {one}" for one in f.setup.block_texts(f.diagnosis)[:2])
        begin.append(f"Its extended diagnosis says {hex_text(f.diagnosis.ext)}{texts_of}.")
    if silent and not f.prm_fault:
        yield Finding(Cause.SERVICE_REFUSED, 0.4, begin)
    mismatch = list(_dpv1(f, begin))
    yield from mismatch
    # a length or a value that the GSD file excludes is wrong for sure; DP-V1 alone may be the reason, too
    other = max((one.confidence for one in mismatch), default=0.0)
    if known.wrong_length:
        sent = octets_text(len(known.sent))
        said = [*begin, f"It was sent {sent} of user parameters; its GSD file or drive profile has {known.wanted}."]
        yield Finding(Cause.USER_PARAMETER_LENGTH, 0.89, said)
        yield Finding(Cause.USER_PARAMETER, 0.3, begin, ["Their number is wrong already."])
        return
    if not known.sent:
        said = [*begin, "It was sent no user parameters at all, so no value of them can be wrong."]
        yield Finding(Cause.USER_PARAMETER_LENGTH, 0.85, said)
        return
    where = f"Octets {SET_PRM_LEN + 1} to {SET_PRM_LEN + len(known.sent)} of Set_Prm are user parameters."
    if known.wanted is not None:
        fits = f"Their number ({len(known.sent)}) is that of the GSD file."
        found = [*known.impossible, *known.changed]
        sure = 0.91 if known.impossible else 0.86 if found else 0.5 if other >= 0.4 else 0.75
        none = [] if found else ["All of them are those of the GSD file."]
        if f.modules_refused and not known.impossible:  # a value that differs from its default is no proof
            sure, none = 0.5, [*none, "The station has other modules than configured: Get_Cfg proves that."]
        yield Finding(Cause.USER_PARAMETER, sure, [*begin, *found, fits], none)
        yield Finding(Cause.USER_PARAMETER_LENGTH, 0.25, begin, [fits])
    else:
        against = ["No GSD file is configured: neither values nor their number can be checked."]
        yield Finding(Cause.USER_PARAMETER, 0.3 if known.only_status else 0.6, [*begin, where], against)
        yield Finding(Cause.USER_PARAMETER_LENGTH, 0.3 if known.only_status else 0.5, begin, against)


def _dpv1(f: Facts, begin: list[str]) -> Findings:
    """Whether master and slave agree about DP-V1."""
    known, device = f.parameters, f.evidence.device
    said = device.dpv1 if device is not None else None
    off = "set dpv1 = false in its configuration"
    if known.dpv1 and said is not None and not said.slave:
        why = "DPV1_Enable is set (octet 8 bit 7 of Set_Prm), and its GSD file says that it is no DP-V1 slave."
        yield Finding(Cause.DPV1_MISMATCH, 0.89, [*begin, why], next=off)
    elif known.dpv1:
        why = "DPV1_Enable is set (octet 8 bit 7 of Set_Prm)."
        only = "There are no other user parameters than DPV1_Status that could be wrong."
        if known.only_status and said is None:
            yield Finding(Cause.DPV1_MISMATCH, 0.78, [*begin, why, only], next=off)
        else:
            backed = ["Its GSD file says that it is a DP-V1 slave."] if said is not None else []
            yield Finding(Cause.DPV1_MISMATCH, 0.35 if backed else 0.5, [*begin, why], backed, next=off)
    elif said is not None and said.slave:
        why = "Its GSD file says that it is a DP-V1 slave, and the configuration switches DP-V1 off."
        others = bool(known.impossible or known.changed or known.wrong_length)
        against = ["Other parameters are not those of the GSD file either."] if others else []
        alone = [] if others else ["Nothing else in Set_Prm differs from the GSD file."]
        todo = "leave dpv1 out of its table"
        yield Finding(Cause.DPV1_MISMATCH, 0.4 if others else 0.8, [*begin, why, *alone], against, next=todo)


def _drops(f: Facts, service: str) -> bool:
    """Whether it never acknowledges ``service`` although it answers Slave_Diag afterwards."""
    step = f.step_of(service)
    if step is None or step.answered != NOTHING or not f.is_fault("refused"):
        return False
    return bool(f.diagnoses_after(service))


_BY_DIFFERENCE: Final = {
    Difference.ORDER: (Cause.MODULE_ORDER, 0.93),
    Difference.MISSING: (Cause.MODULE_MISSING, 0.92),
    Difference.EXTRA: (Cause.MODULE_EXTRA, 0.92),
    Difference.TYPE: (Cause.MODULE_TYPE, 0.92),
    Difference.UNREADABLE: (Cause.MODULE_TYPE, 0.6),
}


def _modules(f: Facts) -> Findings:
    compared = f.comparison
    refused = (f.cfg_fault or _drops(f, CHK_CFG)) and f.wrong_ident is None and f.owner is None
    if f.exchanging or not (refused or f.differs) or f.is_neighbour:
        return
    begin = ["It refuses Chk_Cfg: Cfg_Fault (octet 1 bit 2 of its diagnosis)."] if f.cfg_fault else []
    if not f.cfg_fault and refused:
        begin = ["It never acknowledges Chk_Cfg, and answers Slave_Diag."]
    if compared is None:
        said = [*begin, "It does not give its own configuration by Get_Cfg."]
        yield Finding(Cause.MODULE_TYPE, 0.5, said)
        yield Finding(Cause.MODULE_ORDER, 0.35, said)
        yield Finding(Cause.MODULE_MISSING, 0.35, said)
        yield Finding(Cause.MODULE_EXTRA, 0.25, said)
        return
    if compared.kind is Difference.SAME:
        same = ["Get_Cfg names the same identifiers as the configuration."]
        yield Finding(Cause.MODULE_TYPE, 0.5, begin, same)
        yield Finding(Cause.USER_PARAMETER, 0.35, [*begin, "Some devices choose modules by user parameters."])
        return
    other = f.other_telegram
    cause, confidence = _BY_DIFFERENCE[compared.kind] if other is None else (Cause.TELEGRAM, 0.92)
    said = [*begin, *(compared.sentences if other is None else [])]
    said.append(f"Chk_Cfg and Get_Cfg differ from octet {compared.octet} on.")
    against = []
    if f.modules_refused:
        said.insert(0, "It refuses Set_Prm (Prm_Fault), which is made for the configured modules: it has other ones.")
    elif not refused:
        against = ["It has not refused Chk_Cfg (yet)."]
        confidence = 0.6 if f.evidence.source == CLASS2 or f.is_fault("not_ready", "wrong_length") else 0.5
    if other is not None:
        yield Finding(cause, confidence, said, against, other.remedy, other.text)
        return
    todo = cause.about.next + (f"; the station as it is: {compared.key}" if compared.key else "")
    yield Finding(
        cause, confidence, said, against, todo, ": ".join(filter(None, (cause.about.meaning, compared.short)))
    )


def _lengths(f: Facts) -> Findings:
    step = f.wrong_data
    if step is not None and (f.is_fault("wrong_length") or f.lost):
        got, wanted = octets_text(len(step.received)), f.setup.input_len
        yield Finding(
            Cause.DATA_LENGTH, 0.92, [f"Data_Exchange brought {got} of inputs, the configuration has {wanted}."]
        )
    if _refuses_outputs(f) and f.evidence.history.brought_up:
        said = [
            "It accepted Chk_Cfg, refused Data_Exchange, and says Cfg_Fault since (octet 1 bit 2 of its diagnosis).",
            f"Data_Exchange carries {octets_text(f.setup.output_len)} of outputs.",
        ]
        yield Finding(Cause.DATA_LENGTH, 0.9, said)


def _refuses_outputs(f: Facts) -> bool:
    """Whether a diagnosis after Data_Exchange says Cfg_Fault."""
    return any(one.cfg_fault for one in f.diagnoses_after(DATA_EXCHANGE))


def _refusals(f: Facts) -> Findings:
    if f.exchanging:
        return
    step = f.refused(SLAVE_DIAG, SET_PRM, CHK_CFG)
    if step is not None and (f.is_fault("refused") or step is f.last_step):
        said = [f"{step.asked} was refused with {step.answered}" + (f" {step.times} times." if step.times > 1 else ".")]
        if step.asked == SLAVE_DIAG:
            said.append("Every DP slave serves Slave_Diag in every state.")
        yield Finding(Cause.SERVICE_REFUSED, 0.92 if f.is_fault("refused") else 0.7, said, next=_after(step.answered))
    data = f.refused(DATA_EXCHANGE)
    if data is not None and f.is_fault("refused") and not f.lost_by_itself:
        said = [f"Data_Exchange was refused with {data.answered}, and its diagnosis wants no parameters."]
        yield Finding(Cause.SERVICE_REFUSED, 0.85, said, next=_after(data.answered))


def _after(answered: str) -> str:
    """The next step after a service that was refused with ``answered``: RS, RR or UE."""
    if answered == "RS":
        return "is it a DP slave at all? If it is, switch it off and on: its own start-up may be unfinished"
    return "switch it off and on, and look at its fault display"


# --- ready, watchdog, restarts ----------------------------------------------------------------------------------------


def _readiness(f: Facts) -> Findings:
    diagnosis = f.diagnosis
    if diagnosis is None or f.wrong_ident is not None or f.owner is not None or not (f.exchanging or f.answers_now):
        return
    if diagnosis.prm_fault or diagnosis.cfg_fault or diagnosis.prm_req:
        return
    if diagnosis.stat_diag:
        texts = [f"Its extended diagnosis says: {one}." for one in f.setup.block_texts(diagnosis)[:3]]
        said = ["Stat_Diag is set in its diagnosis (octet 2 bit 1): its data are not valid.", *texts]
        yield Finding(Cause.STATIC_DIAGNOSIS, 0.93, said)
        if diagnosis.not_ready:
            yield Finding(Cause.NOT_READY, 0.5, ["Station_Not_Ready is set, too."], ["Stat_Diag names a fault."])
    elif diagnosis.not_ready and not f.exchanging:
        asked = f.step_of(CHK_CFG)
        waited = 0 if asked is None else f.evidence.now_ns - asked.t_ns
        said = ["It accepted Set_Prm and Chk_Cfg, and Station_Not_Ready (octet 1 bit 1) stays set."]
        if waited:
            said.append(f"It has not been ready for {waited / NS_PER_S:.1f} s.")
        clear = all(step.answered == "DL" for step in f.after(CHK_CFG))
        sure = f.is_fault("not_ready") or (waited >= _READY_NS and clear and f.evidence.state is SlaveState.WAIT_READY)
        yield Finding(Cause.NOT_READY, 0.6 if f.differs else 0.91 if sure else 0.55 if clear else 0.3, said)


def _watchdog(f: Facts) -> Findings:
    wants_again = f.is_fault("not_ready") and f.diagnosis is not None and f.diagnosis.prm_req
    if not (f.lost_by_itself or wants_again) or f.prm_fault or f.cfg_fault:
        return
    if f.wrong_data is not None or _refuses_outputs(f):
        return
    watchdog, line = f.evidence.watchdog_ns, f.evidence.line
    every = f.setup.every
    said = [f"It left data exchange by itself {times_text(f.lost_by_itself)} and wanted parameters again."]
    if wants_again and not f.lost_by_itself:
        said = ["It acknowledges parameters and configuration, and wants parameters again."]
    restarts = 0.72 if f.lost_by_itself >= 2 else 0.5
    if not watchdog:
        yield Finding(Cause.REBOOTS, restarts + 0.1, [*said, "Its watchdog is off, so it was not its watchdog."])
        return
    set_to = f"Its watchdog is {f.watchdog_ms:g} ms."
    longest = line.longest_ns * every
    planned = line.planned_ns * every
    if longest and watchdog <= longest:
        why = f"Two requests to it were up to {ms_text(longest)} apart."
        yield Finding(Cause.WATCHDOG_SHORT, 0.89, [*said, set_to, why])
        yield Finding(Cause.REBOOTS, 0.3, said, [set_to + " " + why])
    elif watchdog <= planned:
        why = f"By the plan two requests to it may be {ms_text(planned)} apart."
        yield Finding(Cause.WATCHDOG_SHORT, 0.78, [*said, set_to, why])
        yield Finding(Cause.REBOOTS, 0.5, said, [set_to])
    else:
        why = f"Two requests to it were at most {ms_text(longest or planned)} apart, the watchdog is longer."
        yield Finding(Cause.WATCHDOG_SHORT, 0.4, [*said, set_to], [why])
        yield Finding(Cause.REBOOTS, restarts, [*said, why])


def _restarts(f: Facts) -> Findings:
    silent = [loss for loss in f.losses if loss.how == NOTHING]
    if not silent:
        return
    back = [loss for loss in silent if loss.back_ns and loss.prm_req]
    away = sorted((loss.back_ns - loss.t_ns) / NS_PER_S for loss in back)
    steady_s = f.steady_s(silent)
    steady = f"It has been in data exchange for {steady_s:.0f} s since." if steady_s else ""
    if len(back) >= 2 or (back and len(silent) >= 2):
        said = [
            f"It fell silent {times_text(len(silent))} and came back without parameters, after "
            f"{away[0]:.1f} to {away[-1]:.1f} s."
        ]
        against = ["Octets that cannot be read came as well."] if f.damage_here > 3 * len(silent) else []
        found = Finding(Cause.REBOOTS, 0.6 if against else 0.87, said, against)
        yield found.less(0.4, steady) if steady else found
    elif back:
        said = [f"It fell silent once, for {away[0]:.1f} s, and came back without parameters."]
        found = Finding(Cause.REBOOTS, 0.6, said)
        yield found.less(0.25, steady) if steady else found
    kept = [loss for loss in silent if loss.back_ns and not loss.prm_req]
    if kept and not back and not is_late(f.link):
        said = [f"It fell silent {times_text(len(kept))} and kept its parameters: it had power meanwhile."]
        more = "That is a loose contact rather than a restart."
        unpaced = (
            [] if f.evidence.line.paced else ["No wire gives the octets their time here: the computer may be late."]
        )
        yield Finding(Cause.NOISE_ON_STUB, 0.55 if len(kept) >= 2 and not unpaced else 0.3, [*said, more], unpaced)


def _lost_links(f: Facts) -> list[PublisherLink]:
    """The links that the slave reports as lost, and those to publishers that exchange no data."""
    silent = {one.address for one in f.evidence.neighbours if one.state is not SlaveState.DATA_EXCHANGE}
    return [link for link in f.evidence.links if link.good is False or (not link.good and link.publisher in silent)]


def _link_without_data(f: Facts, lost: list[PublisherLink], confidence: float, said: list[str]) -> Finding:
    """It exchanges data with its master, and outputs that publishers give are safe."""
    there = {one.address: one for one in f.evidence.neighbours}
    todo: list[str] = []
    for link in dict.fromkeys(lost):
        publisher = there.get(link.publisher)
        if publisher is None:
            said.append(f"Publisher {link.publisher} is not on this bus.")
            continue
        who = f"Publisher {publisher.address} ({publisher.name})"
        said.append(f"{who} is in state {publisher.state.value}; link: {link.text}.")
        if publisher.state is not SlaveState.DATA_EXCHANGE:
            todo.append(f"bring the publisher into data exchange: `dpstack why CONFIG {publisher.name}`")
        else:
            todo.append(f"compare the inputs of {publisher.name} with the filter; does the slave hear it?")
    return Finding(Cause.LINK_WITHOUT_DATA, confidence, said, next="; ".join(dict.fromkeys(todo)))


#: diagnoses that an answer names
_MOST_DOUBTS: Final = 3


# --- healthy ----------------------------------------------------------------------------------------------------------


def _healthy(f: Facts, found: list[Finding]) -> list[Finding]:
    if not f.exchanging:
        return []
    last = f.evidence.bring_up
    said = ["It is in data exchange."]
    if f.evidence.source == CLASS2 and f.diagnosis is not None and f.diagnosis.master is not None:
        said = [f"It is in data exchange with master {f.diagnosis.master}."]
    elif last is not None and last.exchanging_ns:
        said.append(f"It has been there for {(f.evidence.now_ns - last.exchanging_ns) / NS_PER_S:.1f} s.")
    if failures(f.link) and attempts(f.link):
        said.append(f"{failures(f.link)} of {attempts(f.link)} requests had no good answer ({share(f.link):.2%}).")
    worst = max((one.confidence for one in found), default=0.0)
    against = [f"It left data exchange {times_text(f.lost)}."] if f.lost else []
    confidence = 0.25 if f.flaps else 0.95 if worst < 0.3 and not f.lost else 0.7 if worst < 0.5 else 0.4
    if lost := _lost_links(f):
        return [_link_without_data(f, lost, confidence, said)]
    doubts = [one for one in f.doubts if one.trust is not Trust.GOOD][:_MOST_DOUBTS]
    if doubts:
        reported = "; ".join(one.text for one in doubts)
        todo = "; ".join(dict.fromkeys(one.remedy for one in doubts if one.remedy))
        meaning = f"the slave is in data exchange, and reports: {reported}"
        return [Finding(Cause.OWN_DIAGNOSIS, confidence, said, against, todo, meaning)]
    return [Finding(Cause.HEALTHY, confidence, said, against)]


_RULES: Final[tuple[Callable[[Facts], Findings], ...]] = (
    _deactivated,
    _another_program,
    _ring,
    _absent,
    _elsewhere,
    _ident,
    _doubled,
    _noise,
    _late,
    _locked,
    _isochronous,
    _parameters,
    _modules,
    _lengths,
    _refusals,
    _readiness,
    _watchdog,
    _restarts,
)
