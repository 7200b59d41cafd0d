"""Every reason of an Abort: the code on the wire, and the words for people."""

from __future__ import annotations

import pytest

from dpstack.dpv1.pdu.ms2 import Abort, AbortReason, Instance, Subnet

MS2 = {
    1: "a service that is not allowed in this state (ABT_SE)",
    2: "a request that cannot be read (ABT_FE)",
    3: "nothing was heard from the other end in time (ABT_TO)",
    4: "a response that cannot be read (ABT_RE)",
    5: "an impossible service of its user (ABT_IV)",
    6: "the send time-out asked for is too short (ABT_STO)",
    7: "an address in Initiate (API, access level, network) that it does not have (ABT_IA)",
    8: "it still waits for the end of a service (ABT_OC)",
    15: "it has no connection left (ABT_RES)",
}
LINK = {
    1: "an error of the user (UE)",
    2: "no resource (RR)",
    3: "the service access point is closed (RS)",
    9: "no data (NR)",
    10: "data, high priority (DH)",
    11: "no resource at the own station (LR)",
    12: "data, low priority, but no resource (RDL)",
    13: "data, high priority, but no resource (RDH)",
    14: "not in the logical ring (DS)",
    15: "the other station does not answer (NA)",
}


@pytest.mark.parametrize("reason", range(16))
def test_octets_and_words(reason: int) -> None:
    unknown = f"a reserved reason (reason {reason})"
    for subnet, where in ((0, ""), (1, " in its own subnet"), (2, " in a remote subnet"), (3, "")):
        for instance, words in (
            (0, "its link layer: " + LINK.get(reason, unknown)),
            (1, MS2.get(reason, unknown)),
            (2, f"its user, reason {reason}"),
            (3, f"instance 3, reason {reason}"),
        ):
            octets = bytes((0x58, subnet, instance << 4 | reason))
            abort = Abort(reason, instance, subnet)
            assert abort.build() == octets
            assert Abort.parse(octets) == abort
            text = words.removesuffix(")") + where + (")" if words.endswith(")") else "")
            assert abort.text == text + (", both reserved" if instance == 3 else "")


def test_codes() -> None:
    assert {each.name: each.value for each in AbortReason} == {
        "SEQUENCE": 1,
        "REQUEST_PDU": 2,
        "TIMEOUT": 3,
        "RESPONSE_PDU": 4,
        "SERVICE": 5,
        "SEND_TIMEOUT": 6,
        "ADDRESS": 7,
        "WAITING": 8,
        "RESOURCE": 15,
    }
    assert [each.value for each in (Instance.FDL, Instance.MS2, Instance.USER)] == [0, 1, 2]
    assert [each.value for each in (Subnet.NONE, Subnet.LOCAL, Subnet.REMOTE)] == [0, 1, 2]
    assert Abort(5) == Abort(5, Instance.MS2, Subnet.NONE)
