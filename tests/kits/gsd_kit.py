"""GSD files for tests: small ones that each show one construct (``tests/gsd/files``), and texts made on the spot."""

from __future__ import annotations

from pathlib import Path

from dpstack.gsd.model import Device, Diagnostic, GsdFile
from dpstack.gsd.parser import load_gsd, parse_gsd
from dpstack.trace import Severity

FILES = Path(__file__).resolve().parents[1] / "gsd" / "files"
#: a drive with identifiers as makers of PROFIdrive drives print them
PROFIDRIVE = """\
#Profibus_DP
GSD_Revision = 3
Vendor_Name = "Nobody Drives"
Model_Name = "Inverter N1"
Revision = "1"
Ident_Number = 0x0FFD
Protocol_Ident = 0
Station_Type = 0
FMS_supp = 0
Hardware_Release = "1"
Software_Release = "1"
187.5_supp = 1
500_supp = 1
MaxTsdr_187.5 = 60
MaxTsdr_500 = 100
Auto_Baud_supp = 1
Modular_Station = 1
Max_Module = 2
Max_Input_Len = 28
Max_Output_Len = 28
Max_Data_Len = 56
User_Prm_Data_Len = 3
User_Prm_Data = 0x00,0x00,0x00
Module = "Standard telegram 1, PZD-2/2" 0xC3,0xC1,0xC1,0xFD,0x00,0x01
EndModule
Module = "Telegram 352, PZD-6/6" 0xC3,0xC5,0xC5,0xFD,0x01,0x60
EndModule
Module = "PPO 1: 4 PKW + 2 PZD" 0xF3,0xF1
EndModule
Module = "4 PKW" 0xF3
EndModule
Module = "6 PZD" 0xF5
EndModule
Module = "status only" 0x40,0x00
EndModule
"""
HEAD = "#Profibus_DP\nGSD_Revision = 3\nIdent_Number = 0x0FFE\n500_supp = 1\n"


def octets(name: str) -> bytes:
    """The octets of ``files/<name>.gsd``."""
    return (FILES / f"{name}.gsd").read_bytes()


def read(name: str) -> GsdFile:
    """That file, read."""
    return load_gsd(octets(name), f"{name}.gsd")


def device(name: str) -> Device:
    """The device of that file."""
    return read(name).device


def made(text: str) -> GsdFile:
    """A sound head with ``text`` behind it (which begins on line 5)."""
    return parse_gsd((HEAD + text).encode("cp1252"), "made.gsd")


def texts(file: GsdFile) -> list[str]:
    """Its diagnostics as people see them."""
    return [diagnostic.text for diagnostic in file.diagnostics]


def errors(file: GsdFile) -> tuple[Diagnostic, ...]:
    """Its diagnostics that are errors."""
    return tuple(diagnostic for diagnostic in file.diagnostics if diagnostic.severity is Severity.ERROR)
