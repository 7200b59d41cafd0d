"""User parameters of Set_Prm held against the GSD file: their length, values out of range, values that differ."""

from __future__ import annotations

import contextlib
from dataclasses import dataclass

from dpstack.dp.pdu.requests import SET_PRM_LEN
from dpstack.dp.slave_params import SlaveParams
from dpstack.errors import GsdError
from dpstack.gsd.model import in_ranges
from dpstack.gsd.prm import UserPrm
from dpstack.params import DPV1_STATUS_LEN
from dpstack.why.evidence import Evidence

#: parameters named in a story at most
_SHOWN = 4


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


def parameter_facts(evidence: Evidence) -> ParameterFacts:
    """The facts about the user parameters of the slave, as its configuration has them."""
    setup, expected = evidence.setup, evidence.expected_prm
    sent = setup.user_octets(None)
    dpv1 = setup.dpv1 is not None
    if expected is None:
        return ParameterFacts(sent, dpv1=dpv1)
    blocks = len(sent) - len(setup.user_prm)
    wanted = len(expected) + blocks
    if len(setup.user_prm) != len(expected):
        return ParameterFacts(sent, wanted, dpv1=dpv1)
    impossible, changed = _named(evidence, setup, expected)
    return ParameterFacts(sent, wanted, impossible, changed, dpv1)


def _named(evidence: Evidence, setup: SlaveParams, expected: bytes) -> tuple[tuple[str, ...], tuple[str, ...]]:
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
