"""Data exchange broadcast in `dpstack decode`: MSRD and its answer to all, filters in Set_Prm, link status."""

from __future__ import annotations

from octet_slave import frame

from dpstack.capture.transmission import Transmission
from dpstack.decode.telegram import Explained, explain

#: of the VPC3+C manual, p 58, with FCS
MSRD = bytes.fromhex("68 05 05 68 05 02 77 01 02 81 16")
TO_ALL = frame(bytes.fromhex("7F 05 08 AA BB"))
PRM_HEAD = bytes.fromhex("89 82 5D 3D 3E 88 01 14 0B 12 34 00")
PRM = frame(PRM_HEAD + bytes.fromhex("A0 00 08 0B 07 00 00 01 07 04 01 03 01 02"))
PRM_LINKS = frame(PRM_HEAD + bytes.fromhex("80 00 08 09 03 00 00 01 07 04 01 01"))
PRM_SINAMICS = frame(PRM_HEAD + bytes.fromhex("80 00 08 0C E2 00 00 E2 01 03 07 04 01 03 02"))
ASK_DIAG = frame(bytes.fromhex("89 82 7D 3C 3E"))
DIAG = frame(bytes.fromhex("82 89 08 3E 3C 08 0C 00 02 12 34 08 83 00 00 07 81 08 40"))
ALL = (MSRD, TO_ALL, PRM, b"\xe5", PRM_LINKS, b"\xe5", PRM_SINAMICS, b"\xe5", ASK_DIAG, DIAG)


def sent(*telegrams: bytes) -> list[Transmission]:
    made, at = list[Transmission](), 0
    for octets in telegrams:
        made.append(Transmission(octets, at, 500_000))
        at += 22_000 * len(octets) + 100_000
    return made


def seen(*telegrams: bytes) -> list[Explained]:
    return list(explain(sent(*telegrams)))


def test_the_answer_to_all_answers_msrd() -> None:
    request, answer = (one.as_dict() for one in seen(MSRD, TO_ALL))
    assert request["service"] == "MSRD"
    assert "5 -> all" in str(answer["text"])
    course = answer["course"]
    assert isinstance(course, dict)
    assert course["answer_to"] == 1
    assert round(course["response_us"]) == 100


def test_an_answer_to_all_to_another_request_is_none() -> None:
    _, answer = seen(frame(bytes.fromhex("05 02 7D 01 02")), TO_ALL)
    course = answer.as_dict()["course"]
    assert isinstance(course, dict)
    assert course["answer_to"] is None


def test_publisher_enable_and_links_in_set_prm() -> None:
    first, second, third = (one.fields for one in seen(PRM, PRM_LINKS, PRM_SINAMICS))
    assert (first["Publisher_Enable"], second["Publisher_Enable"]) == (True, False)
    links = []
    for found in (first, second, third):
        blocks = found["Blocks"]
        assert isinstance(blocks, list)
        links += [block["links"] for block in blocks]
    assert links == [
        ["octets 1..2 of the 4 of publisher 7 to output octet 1 of slot 3"],
        ["octet 1 of the 4 of publisher 7"],
        ["octets 1..2 of the 4 of publisher 7 to output octet 3"],
    ]


def test_the_link_status_in_words() -> None:
    _, answer = seen(ASK_DIAG, DIAG)
    wanted = "DXB link status: publisher 7: valid data, publisher 8: the broadcast has another length than the filter"
    assert wanted in str(answer.as_dict()["text"])
