"""The importer of STEP 7 exports: the text that it makes is a configuration, whatever the file holds."""

from __future__ import annotations

from typing import Final

from dpstack.api.config.config import check_config, parse_config
from dpstack.errors import ConfigError
from dpstack.gsd.parser import load_gsd
from dpstack.importers.step7_cfg import Remark, read_cfg
from dpstack.importers.step7_plant import dp_systems, make_plant
from dpstack.importers.step7_slaves import Found
from tests.fuzz.frame import Target, assert_plain, parsed, words

_GSD: Final = b"""#Profibus_DP
GSD_Revision = 3
Ident_Number = 0x1234
OrderNumber = "6ES7 153-1AA03-0XB0"
Modular_Station = 1
Max_Module = 8
Max_Input_Len = 64
Max_Output_Len = 64
Max_Data_Len = 128
Module = "DI" 0x10
EndModule
Module = "6ES7 331-1KF01-0AB0 AI" 0x57
EndModule
"""


class _Finder:
    """One file, which has every name and every order number."""

    def __init__(self) -> None:
        self._found = Found("a.gsd", load_gsd(_GSD, "a.gsd").device)

    def named(self, name: str, ident: int | None) -> list[Found]:
        return [self._found]

    def with_order(self, number: str) -> list[Found]:
        return [self._found]


_FINDER: Final = _Finder()


def _refused(text: str) -> str:
    """Why a configuration is refused. The GSD file of the finder is not there, so its slaves have their octets."""
    config, errors = check_config(text)
    if config is not None and not errors:
        return ""
    why = str(errors[0])
    assert_plain(why)
    assert "not valid TOML" not in why, text
    return why


def run(octets: bytes) -> None:
    """The octets are a file."""
    export = parsed(read_cfg, octets, ConfigError)
    if export is None:
        return
    numbers = [system.number for system in dp_systems(export, [])]
    for finder in (None, _FINDER):
        for number in (None, *numbers[:3]):
            made = read_cfg(octets)
            plant = parsed(lambda _, n=number, f=finder, e=made: make_plant(e, n, f, _refused), b"", ConfigError)  # type: ignore[misc]
            if plant is not None:
                parse_config(plant.text)
                assert all(isinstance(remark, Remark) for remark in plant.remarks)
                assert len(plant.slaves) == len(plant.system.slaves)


def repair(octets: bytes) -> bytes:
    """Let the file begin as an export does."""
    return octets if octets.startswith(_BEGIN) else _BEGIN + octets


_BEGIN: Final = b'STATION S7300 , "x"\nBEGIN\nEND\n'

TARGET = Target(
    run,
    covers=("dpstack.importers",),
    max_len=600,
    repair=repair,
    words=(*words("step7_cfg"), b'"', b'""', b"\r\n", b", ", b"\xfc", b"\xcf\xf0\xe8", b"\0"),
    slow_s=2.0,
)
