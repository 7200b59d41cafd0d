"""How long telegrams and exchanges take on the wire, in octets and bit times, counted as they are really sent."""

from __future__ import annotations

from typing import Final

from dpstack.dp.diagnosis import MAX_LEN
from dpstack.dp.rates import Share
from dpstack.dp.setup import SlaveSetup
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
LONGEST_TELEGRAM: Final = SD2_FRAME + 246


def request_octets(setup: SlaveSetup) -> int:
    """Octets of Data_Exchange to ``setup``: SD1 when it has no outputs, else SD2 without SAPs."""
    return SD2_FRAME + setup.output_len if setup.output_len else SD1_OCTETS


def answer_octets(setup: SlaveSetup) -> int:
    """Octets of its answer: SC when it has no inputs, else SD2 without SAPs."""
    return SD2_FRAME + setup.input_len if setup.input_len else SC_OCTETS


def chars(octets: int) -> int:
    """Bit times of ``octets`` characters without gaps."""
    return octets * BITS_PER_CHAR


def shortest_tsdr(params: BusParams, setup: SlaveSetup) -> int:
    """The T_SDR of ``setup`` at the least, in bit times: the bus's min T_SDR, or what Set_Prm tells it."""
    return max(params.min_tsdr, setup.min_tsdr)


def longest_tsdr(params: BusParams, setup: SlaveSetup) -> int:
    """The T_SDR of ``setup`` at the most, in bit times: its MaxTsdr, or the bus's max T_SDR."""
    longest = params.max_tsdr if setup.max_tsdr is None else setup.max_tsdr
    return max(shortest_tsdr(params, setup), longest)


def vain_bits(params: BusParams, request: int) -> int:
    """A request of so many octets and the whole slot time in vain."""
    return chars(request) + max(params.t_sl, params.t_id1)


def exchange_bits(params: BusParams, request: int, answer: int, tsdr: int, retries: int = 0) -> int:
    """Request, T_SDR, answer, T_ID1; before it ``retries`` times the request with the whole slot time in vain."""
    return retries * vain_bits(params, request) + chars(request) + tsdr + chars(answer) + params.t_id1


def data_bits(params: BusParams, setup: SlaveSetup, tsdr: int, retries: int = 0) -> int:
    """Data_Exchange with ``setup``."""
    return exchange_bits(params, request_octets(setup), answer_octets(setup), tsdr, retries)


def diagnosis_bits(params: BusParams, setup: SlaveSetup, retries: int = 0) -> int:
    """Slave_Diag with the longest diagnosis of ``setup``, 244 octets where its Max_Diag_Data_Len is not known."""
    octets = DIAG_REQUEST + (MAX_LEN if setup.max_diag_len is None else setup.max_diag_len)
    return exchange_bits(params, DIAG_REQUEST, octets, longest_tsdr(params, setup), retries)


def acyclic_bits(params: BusParams, retries: int = 0) -> int:
    """The longest acyclic service: as many octets as a telegram can have, and an empty answer."""
    return exchange_bits(params, LONGEST_TELEGRAM, DIAG_REQUEST, params.max_tsdr, retries)


def token_bits(params: BusParams) -> int:
    """The token to oneself and T_ID1."""
    return chars(TOKEN_OCTETS) + params.t_id1


def gap_poll_bits(params: BusParams) -> int:
    """A silent GAP poll; 0 where the GAP is off."""
    return vain_bits(params, GAP_REQUEST) if params.gap else 0


def global_control_bits(params: BusParams) -> int:
    """Global_Control, which nobody answers."""
    return chars(GLOBAL_CONTROL) + params.t_id2


def share(params: BusParams, setup: SlaveSetup) -> Share:
    """What ``setup`` takes of a cycle at the least: by this the master and the plan spread the rate groups."""
    return Share(setup.address, setup.every, params.ns(data_bits(params, setup, shortest_tsdr(params, setup))))
