"""Durations of telegrams and exchanges on the wire, in octets and bit times, counted as they are really sent."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final

from dpstack.dp.pdu.diagnosis import MAX_LEN
from dpstack.dp.rate_groups import Share
from dpstack.dp.slave_params import SlaveParams
from dpstack.params import BusParams
from dpstack.units import BITS_PER_CHAR

TOKEN_OCTETS: Final = 3
SD1_OCTETS: Final = 6
#: SD, LE, LEr, SD, DA, SA, FC, FCS, ED
SD2_FRAME: Final = 9
SC_OCTETS: Final = 1
SAPS: Final = 2
#: FDL status: SD1 both ways
GAP_REQUEST: Final = SD1_OCTETS
GLOBAL_CONTROL: Final = SD2_FRAME + SAPS + 2
#: Slave_Diag without data
DIAG_REQUEST: Final = SD2_FRAME + SAPS
#: a PDU of DP-V1 (MS1, MS2): four octets, then those of the record, the alarm or the transport
PDU_HEAD: Final = 4
LONGEST_PDU: Final = PDU_HEAD + 240


def request_octets(setup: SlaveParams) -> int:
    """Octets of Data_Exchange to ``setup``: SD1 when it has no outputs, else SD2 without SAPs."""
    return SD2_FRAME + setup.output_len if setup.output_len else SD1_OCTETS


def answer_octets(setup: SlaveParams) -> int:
    """Octets of its answer: SC when it has no inputs, else SD2 without SAPs."""
    return SD2_FRAME + setup.input_len if setup.input_len else SC_OCTETS


def chars(octets: int) -> int:
    """Bit times of ``octets`` characters without gaps."""
    return octets * BITS_PER_CHAR


def shortest_tsdr(params: BusParams, setup: SlaveParams) -> int:
    """The shortest T_SDR of ``setup`` in bit times: the min T_SDR of the bus, or the one in Set_Prm."""
    return max(params.min_tsdr, setup.min_tsdr)


def longest_tsdr(params: BusParams, setup: SlaveParams) -> int:
    """The longest T_SDR of ``setup`` in bit times: its MaxTsdr, or the max T_SDR of the bus."""
    return max(shortest_tsdr(params, setup), setup.max_tsdr.get(params.baud, params.max_tsdr))


def vain_bits(params: BusParams, request: int) -> int:
    """An unanswered request of ``request`` octets with the whole slot time."""
    return chars(request) + max(params.t_sl, params.t_id1)


def exchange_bits(params: BusParams, request: int, answer: int, tsdr: int, retries: int = 0) -> int:
    """Request, T_SDR, answer, T_ID1; before it ``retries`` unanswered requests."""
    return retries * vain_bits(params, request) + chars(request) + tsdr + chars(answer) + params.t_id1


def data_bits(params: BusParams, setup: SlaveParams, tsdr: int, retries: int = 0) -> int:
    """Data_Exchange with ``setup``."""
    return exchange_bits(params, request_octets(setup), answer_octets(setup), tsdr, retries)


def diagnosis_bits(params: BusParams, setup: SlaveParams, retries: int = 0) -> int:
    """Slave_Diag with the longest diagnosis of ``setup``, 244 octets if its Max_Diag_Data_Len is not known."""
    octets = DIAG_REQUEST + (MAX_LEN if setup.max_diag_len is None else setup.max_diag_len)
    return exchange_bits(params, DIAG_REQUEST, octets, longest_tsdr(params, setup), retries)


def service_octets(data: int) -> int:
    """A telegram with SAPs and so many octets of data."""
    return SD2_FRAME + SAPS + data


def service_bits(params: BusParams, request: int, answer: int, tsdr: int, retries: int = 0) -> int:
    """One SRD from SAP to SAP with ``request`` and ``answer`` octets of data; or all attempts without an answer, if
    that is longer: a slave in data exchange may still be silent at another SAP.
    """
    octets = service_octets(request)
    answered = exchange_bits(params, octets, service_octets(answer), tsdr, retries)
    return max(answered, (retries + 1) * vain_bits(params, octets)) if retries else answered


def acyclic_bits(params: BusParams, setups: Iterable[SlaveParams] = (), retries: int = 0) -> int:
    """The longest acyclic service in one token hold.

    That is a Write of 240 octets answered at once (or a Read of as many: the same octets the other way round). Polls,
    alarm acknowledgements, Initiate, Idle, Get_Cfg and Slave_Diag of class 2 are shorter. A Data_Transport with data
    both ways that is answered at once is longer, by 11 bits for each octet of the shorter side.
    """
    return service_bits(params, LONGEST_PDU, PDU_HEAD, slowest_tsdr(params, setups), retries)


def slowest_tsdr(params: BusParams, setups: Iterable[SlaveParams]) -> int:
    """The longest T_SDR of all slaves, and of other stations that class 2 may ask."""
    return max([params.max_tsdr, *(longest_tsdr(params, setup) for setup in setups)])


def token_bits(params: BusParams) -> int:
    """The token to oneself and T_ID1."""
    return chars(TOKEN_OCTETS) + params.t_id1


def gap_poll_bits(params: BusParams) -> int:
    """A silent GAP poll; 0 if the GAP is off."""
    return vain_bits(params, GAP_REQUEST) if params.gap else 0


def global_control_bits(params: BusParams) -> int:
    """Global_Control, which has no answer."""
    return chars(GLOBAL_CONTROL) + params.t_id2


def share(params: BusParams, setup: SlaveParams) -> Share:
    """The shortest time of ``setup`` in a cycle. The master and the plan spread the rate groups by it."""
    return Share(setup.address, setup.every, params.ns(data_bits(params, setup, shortest_tsdr(params, setup))))
