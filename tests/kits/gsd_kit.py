"""GSD files for tests: small ones that each show one construct (``tests/gsd/files``), and texts made on the spot."""

from __future__ import annotations

from pathlib import Path

from dpstack.gsd.model import Device, Diagnostic, GsdFile
from dpstack.gsd.parser import load_gsd, parse_gsd
from dpstack.trace import Severity

FILES = Path(__file__).resolve().parents[1] / "gsd" / "files"
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
