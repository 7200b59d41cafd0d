"""Data exchange broadcast: filter tables, SINAMICS's filter block, link status messages, min T_SDR of a publisher."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.dp.pdu.alarm_blocks import Status, StatusType, parse_block
from dpstack.dp.pdu.dxb import (
    MAX_LINKS,
    SINAMICS_FILTER,
    DriveFilter,
    DriveLink,
    DriveTap,
    Link,
    LinkState,
    block_of,
    filter_of,
    link_problem,
    links_of,
)
from dpstack.dp.pdu.prm_blocks import PrmBlock, parse_blocks
from dpstack.errors import PduError
from dpstack.params import BusParams

#: fields in the order of the VPC3+ header: publisher, its length, sample offset, sample length
LINKS = bytes.fromhex("0D 03 00 00 01 04 08 02 06 05 01 00 01")
#: publisher, its length, sample offset, slot, offset in its data, length
SUBSCRIBERS = bytes.fromhex("0B 07 00 00 01 04 08 02 03 01 06")


def test_a_link_table() -> None:
    assert links_of(parse_blocks(LINKS)) == (Link(4, 8, 2, 6), Link(5, 1, 0, 1))


def test_a_subscriber_table() -> None:
    (link,) = links_of(parse_blocks(SUBSCRIBERS))
    assert link == Link(4, 8, 2, 6, slot=3, to=1)
    assert link.text == "octets 2..7 of the 8 of publisher 4 to output octet 1 of slot 3"


def test_the_fields_of_a_filter_block() -> None:
    """In the order of the SINAMICS S110 function manual, p 605: two links, the first with two taps."""
    data = bytes.fromhex("E2 02 04 0C 06 0A 00 02 02 04 08 02 07 04 00 06 04")
    block = PrmBlock(SINAMICS_FILTER, 0, data)
    table = DriveFilter(
        (DriveLink(6, 10, (DriveTap(0, 2, 2), DriveTap(4, 8, 2))), DriveLink(7, 4, (DriveTap(0, 6, 4),)))
    )
    assert filter_of(block) == table
    assert table.data == data
    assert [link.text for link in links_of([block])] == [
        "octets 0..1 of the 10 of publisher 6 to output octet 2",
        "octets 4..5 of the 10 of publisher 6 to output octet 8",
        "octets 0..3 of the 4 of publisher 7 to output octet 6",
    ]
    assert parse_blocks(block.octets) == (block,)


def test_the_shortest_filter_block_has_12_octets() -> None:
    assert len(block_of([Link(6, 10, 0, 2, to=0)], sinamics=True).octets) == 12


@pytest.mark.parametrize("data", ["", "E2", "E2 01", "E2 01 03", "E2 01 03 06", "E2 01 03 06 0A 00", "E2 01 FF 06 0A"])
def test_octets_that_are_no_filter_block(data: str) -> None:
    octets = bytes.fromhex(data)
    with pytest.raises(PduError, match="filter block"):
        DriveFilter.parse(octets)
    block = PrmBlock(SINAMICS_FILTER, 0, octets)
    assert filter_of(block) is None
    assert links_of([block]) == ()


_OCTET = st.integers(0, 255)


@given(st.binary(max_size=40))
def test_any_filter_block_is_read_or_refused(data: bytes) -> None:
    table = filter_of(PrmBlock(SINAMICS_FILTER, 0, bytes((SINAMICS_FILTER,)) + data))
    assert table is None or all(tap.length <= 255 for link in table.links for tap in link.taps)


@given(st.lists(st.tuples(*[_OCTET] * 6).map(lambda row: Link(*row)), min_size=1, max_size=30))
def test_a_subscriber_table_comes_back(links: list[Link]) -> None:
    assert links_of(parse_blocks(block_of(links).octets)) == tuple(links)


@pytest.mark.parametrize(
    ("links", "problem"),
    [
        ([Link(4, 8, 2, 6), Link(4, 7, 0, 1)], "link 2: publisher 4 has 7 octets, above 8"),
        ([Link(4, 8, 2, 7)], "link 1: octets 2..8 of a publisher with 8"),
        ([Link(4, 8, 2, 0)], "link 1: octets 2..1 of a publisher with 8"),
        ([Link(126, 8, 0, 1)], "link 1: there is no publisher 126: 0..125"),
        ([Link(4, 245, 0, 1)], "link 1: a publisher of 245 octets: 1..244"),
        (
            [Link(4, 8, 0, 4, 1, 0), Link(5, 8, 0, 4, 1, 3)],
            "link 2: publishers 4 and 5 both give output octet 3 of slot 1",
        ),
        ([Link(4, 8, 0, 4, None, 0), Link(5, 8, 0, 4, None, 3)], "link 2: publishers 4 and 5 both give output octet 3"),
        ([Link(4, 8, 0, 4, 1, 0), Link(5, 8, 0, 4, 2, 0), Link(4, 8, 0, 4)], None),
    ],
)
def test_links_that_cannot_be_one_filter(links: list[Link], problem: str | None) -> None:
    assert link_problem(links) == problem


def test_a_link_status_message() -> None:
    """Octets as in the VPC3+C manual, p 61: bit 7 Link_Status, 6 Link_Error, 0 Data_Exist."""
    status = parse_block(bytes.fromhex("0C 83 00 00 04 81 05 40 06 01 07 00"))
    assert isinstance(status, Status)
    assert status.links == (
        LinkState(4, True, False, True),
        LinkState(5, False, True, False),
        LinkState(6, False, False, True),
        LinkState(7, False, False, False),
    )
    assert status.full_text == (
        "DXB link status: publisher 4: valid data, publisher 5: the broadcast has another length than the filter, "
        "publisher 6: data begin to come, publisher 7: no data"
    )
    assert b"".join(link.octets for link in status.links) == status.data


def test_a_link_status_of_half_a_link_shows_its_octets() -> None:
    assert Status(StatusType.DXB_LINK, 0, data=b"\x07").full_text.endswith("data 07")


def test_all_links_fit_into_one_message() -> None:
    states = tuple(LinkState(number, True, False, True) for number in range(MAX_LINKS))
    built = Status(StatusType.DXB_LINK, 0, data=b"".join(one.octets for one in states)).build()
    assert isinstance(back := parse_block(built), Status)
    assert back.links == states


@pytest.mark.parametrize(("baud", "bits"), [(500_000, 39), (1_500_000, 39), (3_000_000, 48), (12_000_000, 78)])
def test_a_publisher_answers_after_an_idle_time(baud: int, bits: int) -> None:
    params = BusParams.preset(baud)
    assert params.publisher_min_tsdr == bits >= params.t_id1
