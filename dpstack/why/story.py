"""The story of one slave: its last bring-up in words, and the causes in order. Made from the evidence alone."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from dpstack.dp.master.scanner import Found
from dpstack.dp.pdu.diagnosis import SlaveView
from dpstack.fdl.telegram import StationType
from dpstack.text import printable
from dpstack.why.causes import Cause
from dpstack.why.evidence import CLASS2, HEARD, RUN, Evidence
from dpstack.why.facts import Facts
from dpstack.why.judge import Finding, judge
from dpstack.why.steps import as_dict, words

#: the cause of a slave that nothing speaks against
HEALTHY: Final = Cause.HEALTHY.word
#: the cause that all slaves share
ALL_SILENT: Final = Cause.ALL_SILENT.word
#: causes with less confidence are left out, unless no other is left
_LEAST = 0.2
_MOST = 6


@dataclass(frozen=True, slots=True)
class Likely:
    """One cause with its ``confidence`` 0..1, plain sentences for and against it, and the next thing to try."""

    #: name of the cause, as ``why --json`` has it
    cause: str
    #: confidence, 0..1
    confidence: float
    #: sentences that speak for it
    speaks_for: tuple[str, ...]
    #: sentences that speak against it
    against: tuple[str, ...]
    #: what to try next
    next: str
    #: the cause in words
    meaning: str

    def as_dict(self) -> dict[str, object]:
        """As in ``why --json``."""
        return {
            "cause": self.cause,
            "confidence": self.confidence,
            "meaning": self.meaning,
            "for": list(self.speaks_for),
            "against": list(self.against),
            "next": self.next,
        }


@dataclass(frozen=True, slots=True)
class Story:
    """Why a slave is, or is not, in data exchange."""

    #: name of the slave
    slave: str
    #: station address, 0..126
    address: int
    #: "run", "class2" if another station looked, "heard" if nobody was asked
    source: str
    #: state of the slave, as the JSON lines have it
    state: str
    #: steps of the last bring-up, as ``why --json`` has them
    steps: tuple[dict[str, object], ...]
    #: time in seconds and text of each step
    step_texts: tuple[tuple[float, str], ...]
    #: causes, the likeliest first; at least one
    causes: tuple[Likely, ...]
    #: the slave is in data exchange, but left it several times, the last time not long ago
    flaps: bool = False

    def as_dict(self) -> dict[str, object]:
        """As in ``why --json``."""
        return {
            "slave": self.slave,
            "address": self.address,
            "source": self.source,
            "state": self.state,
            "steps": [dict(step) for step in self.steps],
            "causes": [cause.as_dict() for cause in self.causes],
        }

    @property
    def first(self) -> Likely:
        """The likeliest cause."""
        return self.causes[0]

    @property
    def line(self) -> str:
        """The likeliest cause in one line."""
        return cause_line(self.first.cause, self.first.confidence, self.first.meaning)

    def lines(self, width: int = 80) -> list[str]:
        """The story for people, at most ``width`` columns wide."""
        return story_lines(self.as_dict(), width)


def cause_line(cause: str, confidence: float, meaning: str) -> str:
    """``module_order (93 %): the modules are the right ones in another order``."""
    return f"{cause} ({round(100 * confidence)} %): {meaning}"


def story_lines(story: Mapping[str, Any], width: int = 80, *, steps: bool = True) -> list[str]:
    """The story in ``why --json`` for people, at most ``width`` columns wide; without ``steps`` the causes only."""
    lines: list[str] = []

    def add(text: str, first: str = "", rest: str = "") -> None:
        wrapped = textwrap.wrap(
            printable(text), max(20, width), initial_indent=first, subsequent_indent=rest, break_on_hyphens=False
        )
        lines.extend(wrapped or [first.rstrip()])

    asked = _SOURCES.get(str(story["source"]), str(story["source"]))
    add(f"slave {story['address']} ({story['slave']}): {story['state']}, seen by {asked}")
    if steps and story["steps"]:
        add("asked:" if story["source"] == CLASS2 else "last bring-up:")
        for step in story["steps"]:
            add(f"{step['t']:.3f} s  {step['text']}", "  ", "    ")
    for number, one in enumerate(story["causes"], 1):
        add(cause_line(one["cause"], one["confidence"], one["meaning"]), f"{number}. ", "   ")
        for text in one["for"]:
            add(text, "   + ", "     ")
        for text in one["against"]:
            add(text, "   - ", "     ")
        if number <= 2:
            add(one["next"], "   next: ", "     ")
    return lines


_SOURCES = {RUN: "its own master", CLASS2: "a class 2 master beside it", HEARD: "a listener, who asked nobody"}


def glance(found: Found) -> str:
    """The likely cause why a slave that a scan ``found`` is not in data exchange, as far as its diagnosis says; empty
    if it is, and for other stations."""
    diagnosis = found.diagnosis
    if found.kind is not StationType.SLAVE or found.state is SlaveView.DATA_EXCHANGE:
        return ""
    if diagnosis is None:
        return f"{Cause.SERVICE_REFUSED.word}: it does not answer Slave_Diag"
    if diagnosis.not_supported:
        return f"{Cause.NOT_SUPPORTED.word}: Not_Supported after Set_Prm"
    if diagnosis.prm_fault:
        return f"{Cause.USER_PARAMETER.word}: it refuses its parameters (Prm_Fault)"
    if diagnosis.cfg_fault:
        return f"{Cause.MODULE_TYPE.word}: it refuses its configuration (Cfg_Fault)"
    if diagnosis.stat_diag and not diagnosis.prm_req:
        return f"{Cause.STATIC_DIAGNOSIS.word}: it cannot give valid data (Stat_Diag)"
    if diagnosis.prm_req or diagnosis.master is None:
        return "it waits for parameters: no master has it"
    if diagnosis.not_ready:
        return f"{Cause.NOT_READY.word}: master {diagnosis.master} has parameterised it, it is not ready"
    return ""


def tell(evidence: Evidence) -> Story:
    """The story by ``evidence``. Never raises for odd evidence."""
    facts = Facts(evidence)
    found = judge(facts)
    shown = [one for one in found if one.confidence >= _LEAST][:_MOST] or found[:1] or [_unknown(evidence)]
    steps = evidence.steps
    setup = evidence.setup
    return Story(
        slave=printable(setup.name),
        address=setup.address,
        source=evidence.source,
        state=evidence.state.value,
        steps=tuple(as_dict(step, evidence) for step in steps),
        step_texts=tuple((evidence.seconds(step.t_ns), words(step, evidence)) for step in steps),
        causes=tuple(_likely(one) for one in shown),
        flaps=facts.flaps,
    )


def _unknown(evidence: Evidence) -> Finding:
    """Nothing speaks for any cause: the bring-up is under way, or it has not begun."""
    fault = evidence.fault
    said = ["The bring-up is under way, and nothing was refused so far."] if fault is None else [fault.message]
    return Finding(Cause.NOT_READY, 0.3, said, next="wait some seconds and ask again")


def _likely(one: Finding) -> Likely:
    about = one.cause.about
    return Likely(
        one.cause.word,
        round(one.confidence, 2),
        tuple(printable(text) for text in _distinct(one.speaks_for)),
        tuple(printable(text) for text in _distinct(one.against)),
        printable(one.next or about.next),
        printable(one.meaning or about.meaning),
    )


def _distinct(texts: list[str]) -> Iterator[str]:
    yield from dict.fromkeys(texts)
