"""Steps of a bring-up in words: the request, the answer, and the octet that refuses."""

from __future__ import annotations

from dpstack.dp.master.bring_ups import DAMAGED, NOTHING, SLAVE_DIAG, WRONG, Step
from dpstack.dp.master.verdicts import foreign_owner
from dpstack.dp.pdu.diag_bits import Reaction, SetBy
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.text import octets_text, printable
from dpstack.why.evidence import Evidence

SET_PRM, CHK_CFG, GET_CFG = "Set_Prm", "Chk_Cfg", "Get_Cfg"
#: octets of a request or an answer in one line for people
_SHOWN = 24
_UNREAD = {
    NOTHING: "no answer",
    DAMAGED: "an answer that cannot be read",
    WRONG: "an answer that belongs to no request of this master",
}
REFUSALS = {
    "RS": "the service is not open in this slave now",
    "RR": "it has no resources for it",
    "UE": "its application reports an error",
}


def hex_text(octets: bytes) -> str:
    """Octets for people; the end of a long row is left out."""
    text = octets[:_SHOWN].hex(" ").upper()
    return f"{text} ... ({len(octets)} octets)" if len(octets) > _SHOWN else text


def bit_text(octet: int, mask: int) -> str:
    """``octet 1 bit 6``."""
    return f"octet {octet} bit {mask.bit_length() - 1}"


def refused_by(step: Step, evidence: Evidence) -> str:
    """The octet or status that refuses, as far as the answer says; empty if it does not refuse."""
    if step.answered in REFUSALS:
        return f"status {step.answered}"
    diagnosis = step.diagnosis
    if diagnosis is None:
        return ""
    if evidence.setup.is_other_ident(diagnosis.ident):
        return f"octets 5-6: ident 0x{diagnosis.ident:04X}"
    owner = foreign_owner(diagnosis, evidence.ring.own)
    if owner is not None:
        return f"octet 4: master {owner}"
    flags = [f for f in diagnosis.findings if f.set_by is SetBy.SLAVE and f.bring_up is Reaction.REFUSES]
    return ", ".join(f"{bit_text(flag.octet, flag.mask)}: {flag_name(flag.name)}" for flag in flags)


def flag_name(name: str) -> str:
    """The standard's spelling of a flag: ``Cfg_Fault``."""
    return "_".join({"wd": "WD", "ext": "Ext"}.get(part, part.capitalize()) for part in name.split("_"))


def words(step: Step, evidence: Evidence) -> str:
    """One step for people in one line."""
    asked = step.asked + (f" {hex_text(step.sent)}" if step.sent else "")
    means = _meaning(step, evidence)
    text = f"{asked}: {means}" if means else asked
    return printable(text + (f" ({step.times} times)" if step.times > 1 else ""))


def _meaning(step: Step, evidence: Evidence) -> str:
    if step.answered in _UNREAD:
        return _UNREAD[step.answered]
    if step.answered == "SC":
        return "acknowledged" + (" (the next diagnosis says whether it was accepted)" if step.sent else "")
    if step.answered in REFUSALS:
        return f"refused with {step.answered}, {REFUSALS[step.answered]}"
    if step.asked == SLAVE_DIAG:
        diagnosis = step.diagnosis
        if diagnosis is None:
            return f"{step.answered} with {octets_text(len(step.received))}, which is no diagnosis"
        return f"{hex_text(step.received)}: {diagnosis_words(diagnosis, evidence)}"
    if step.asked == GET_CFG:
        return f"the slave has {hex_text(step.received)}"
    return f"{step.answered} {hex_text(step.received)}".rstrip()


def diagnosis_words(diagnosis: Diagnosis, evidence: Evidence) -> str:
    """The fixed octets of a diagnosis in a few words."""
    setup, said = evidence.setup, []
    if setup.is_other_ident(diagnosis.ident):
        said.append(f"another device (octets 5-6: ident 0x{diagnosis.ident:04X}, not 0x{setup.ident or 0:04X})")
    owner = foreign_owner(diagnosis, evidence.ring.own)
    if owner is not None:
        said.append(f"owned by master {owner} (octet 4)")
    said += [
        f"{flag.text} ({bit_text(flag.octet, flag.mask)}, {flag_name(flag.name)})"
        for flag in diagnosis.findings
        if flag.set_by is SetBy.SLAVE and flag.name != "wd_on"
    ]
    if not said:
        said.append("ready" + (", watches its master" if diagnosis.wd_on else ""))
    return ", ".join(said) + "".join(f"; {text}" for text in setup.block_texts(diagnosis)[:3])


def as_dict(step: Step, evidence: Evidence) -> dict[str, object]:
    """As in ``why --json``."""
    by = refused_by(step, evidence)
    return {
        "t": round(evidence.seconds(step.t_ns), 6),
        "asked": step.asked,
        "sent": step.sent.hex(),
        "answered": step.answered,
        "received": step.received.hex(),
        "times": step.times,
        "last": round(evidence.seconds(step.last_ns), 6),
        "text": words(step, evidence),
        **({"refused_by": by} if by else {}),
    }
