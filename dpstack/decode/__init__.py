"""Telegrams explained to the bit, one by one and in their course.

- ``columns``: the columns of a table of telegrams, and the cells of a telegram in them
- ``course``: which request a telegram answers or repeats, who holds the token, what is out of order
- ``diagnosis``: a diagnosis without its telegram, as a PLC gives it: octets from pasted text, and in words
- ``fields``: the data unit of a telegram, field by field, under the standard's names
- ``filter``: filters over explained telegrams: a small language that is parsed, never evaluated as code
- ``log_text``: octets in the lines of logs as people paste them: columns with times, words of direction, hex dumps
- ``names``: names and texts of stations: of a user's configuration, or of a GSD file
- ``ppi``: PDUs of an S7-200 in PPI telegrams: what a master asks, and what the CPU answers
- ``source``: where transmissions to be explained come from: a pcapng file, a text file
- ``stations``: the stations of a bus as their own telegrams describe them; fields with their names
- ``telegram``: a telegram explained to the bit: link layer, service, fields, and what it is in the course of the bus
- ``wire_log``: wire logs in words: the log that a failing test and the referee of a simulated bus print
- ``words``: telegrams in words, one line each, made of the fields
"""

from typing import TYPE_CHECKING, Final

from dpstack.namespaces import namespace

if TYPE_CHECKING:
    from dpstack.decode.filter import parse_filter as parse_filter
    from dpstack.decode.log_text import from_hex as from_hex
    from dpstack.decode.names import CpuNames as CpuNames
    from dpstack.decode.names import ModuleName as ModuleName
    from dpstack.decode.names import Names as Names
    from dpstack.decode.names import SlaveNames as SlaveNames
    from dpstack.decode.source import read_transmissions as read_transmissions
    from dpstack.decode.telegram import Explained as Explained
    from dpstack.decode.telegram import Explainer as Explainer
    from dpstack.decode.telegram import explain as explain
    from dpstack.decode.wire_log import render as render

#: module and its public names
_PLACES: Final = """
filter parse_filter
log_text from_hex
names CpuNames ModuleName Names SlaveNames
source read_transmissions
telegram Explained Explainer explain
wire_log render
"""
if not TYPE_CHECKING:  # a type checker knows the names
    __getattr__, __dir__, __all__ = namespace(__name__, _PLACES)
