"""What the DP-V1 keywords of a file contradict each other in, and how that is read.

GSD specification (PNO order 2.122), section on DP extensions: each of these keywords may be left out and is 0 then;
``..._supp`` says what a device can do, ``..._required`` what its master has to use, lengths and counts how much of it.
"""

from __future__ import annotations

from collections.abc import Iterator

from dpstack.gsd.keywords import ALARMS
from dpstack.gsd.model import DpV1

#: PDU of an Initiate without addresses in other networks
_LEAST_INITIATE = 20


def oddities(dpv1: DpV1) -> Iterator[tuple[str, str]]:
    """(keyword in lower case that tells the place, text for people) of each."""
    if not dpv1.slave and (dpv1.c1_read_write or dpv1.alarms):
        keyword = "c1_read_write_supp" if dpv1.c1_read_write else f"{dpv1.alarms[0].lower()}_supp"
        yield keyword, "without DPV1_Slave = 1: neither Read and Write nor alarms of class 1 are used"
    yield from _required(dpv1)
    yield from _class2(dpv1)


def _required(dpv1: DpV1) -> Iterator[tuple[str, str]]:
    for number, supported, required in (
        (1, dpv1.c1_read_write, dpv1.c1_read_write_required),
        (2, dpv1.c2_read_write, dpv1.c2_read_write_required),
    ):
        if required and not supported:
            without = f"C{number}_Read_Write_required = 1 without C{number}_Read_Write_supp = 1"
            yield f"c{number}_read_write_required", f"{without}: read as a device without them"
    for alarm in ALARMS:
        if alarm in dpv1.required and alarm not in dpv1.alarms:
            yield (
                f"{alarm.lower()}_required",
                f"{alarm}_required = 1 without {alarm}_supp = 1: it is enabled all the same",
            )


def _class2(dpv1: DpV1) -> Iterator[tuple[str, str]]:
    if not dpv1.c2_read_write:
        for keyword, name, value in (
            ("c2_max_count_channels", "C2_Max_Count_Channels", dpv1.c2_max_count_channels),
            ("c2_max_data_len", "C2_Max_Data_Len", dpv1.c2_max_data_len),
        ):
            if value:
                yield keyword, f"{name} = {value} without C2_Read_Write_supp = 1: read as no class 2 connections"
        return
    for name, value, read_as in (
        ("C2_Max_Count_Channels", dpv1.c2_max_count_channels, "read as one connection"),
        ("C2_Max_Data_Len", dpv1.c2_max_data_len, "read as 240 octets"),
        ("C2_Response_Timeout", dpv1.c2_response_timeout, "the send time-out of a connection counts"),
    ):
        if not value:
            yield "c2_read_write_supp", f"C2_Read_Write_supp = 1 without {name}: {read_as}"
    if 0 < dpv1.max_initiate_pdu_length < _LEAST_INITIATE:
        text = f"Max_Initiate_PDU_Length = {dpv1.max_initiate_pdu_length}: an Initiate has {_LEAST_INITIATE} octets"
        yield "max_initiate_pdu_length", f"{text} at least; read as that"
