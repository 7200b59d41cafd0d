"""Common tables of HART: engineering units (2), makers (8); packed ASCII, dates and Latin-1 texts.

Sources: docs/reference/decisions/hart.md.
"""

from __future__ import annotations

import datetime
from collections.abc import Mapping
from typing import Final

from dpstack.errors import PduError

#: "not used" in tables of HART
NOT_USED: Final = 250
#: codes whose meaning each maker defines, and codes whose meaning depends on the class of the variable
MAKERS: Final = range(240, 250)
EXPANDED: Final = range(170, 220)
_SPECIAL: Final[Mapping[int, str]] = {NOT_USED: "not used", 251: "", 252: "unknown unit", 253: "special unit"}
#: the first code of a run, and the units of the codes from it on
_RUNS: Final = (
    (1, "inH2O(68F) inHg(0C) ftH2O(68F) mmH2O(68F) mmHg(0C) psi bar mbar g/cm² kg/cm² Pa kPa torr atm"),
    (15, "ft³/min gal/min l/min gal(imp)/min m³/h ft/s m/s gal/s Mgal/d l/s Ml/d ft³/s ft³/d m³/s m³/d"),
    (30, "gal(imp)/h gal(imp)/d °C °F °R K mV Ω Hz mA gal l gal(imp) m³ ft m bbl in cm mm min s h d cSt cP µS % V pH"),
    (60, "g kg t lb tn(sh) tn(l) mS/cm µS/cm N Nm g/s g/min g/h kg/s kg/min kg/h kg/d t/min t/h t/d lb/s lb/min lb/h"),
    (83, "lb/d tn(sh)/min tn(sh)/h tn(sh)/d tn(l)/h tn(l)/d datherm SG g/cm³ kg/m³ lb/gal lb/ft³ g/ml kg/l g/l lb/in³"),
    (99, "tn(sh)/yd³ °Tw °Bx °Bé(heavy) °Bé(light) °API %(solids,mass) %(solids,vol) °Balling proof(vol) proof(mass)"),
    (110, "bu yd³ ft³ in³ in/s in/min ft/min °/s 1/s rpm m/h Nm³/h Nl/h scf/min bbl(liq) oz ft·lbf kW kWh hp ft³/h"),
    (131, "m³/min bbl/s bbl/min bbl/h bbl/d gal/h gal(imp)/s l/h ppm Mcal/h MJ/h Btu/h ° rad inH2O(60F) µg/l µg/m³"),
    (148, "%(consistency) %(vol) %(steam) ft·in/16 ft³/lb pF ml/l µl/l dB"),
    (160, "°P %LEL Mcal kΩ MJ Btu Nm³ Nl scf ppb"),
    (235, "gal/d hl MPa inH2O(4C) mmH2O(4C)"),
)
_UNITS: Final[Mapping[int, str]] = {first + at: unit for first, units in _RUNS for at, unit in enumerate(units.split())}


def unit_text(code: int) -> str:
    """The unit of ``code`` 0..255; empty for 251 (none). One without a known meaning is shown as its number."""
    if code in _SPECIAL:
        return _SPECIAL[code]
    if code in MAKERS:
        return f"unit {code} (the maker's own)"
    if code in EXPANDED:
        return f"unit {code} (its meaning depends on the class of the variable)"
    return _UNITS.get(code, f"unit {code}")


def known_units() -> Mapping[int, str]:
    """All codes with a meaning of their own."""
    return _UNITS


# --- makers ---
#: the codes 1 to 166 of HART 5, as far as public sources have them
_MAKERS: Final = """\
Acromag,Allen Bradley,Ametek,Analog Devices,Elsag Bailey,Beckman,Bell Microsensor,Bourns,Bristol Babcock,
Brooks Instrument,Chessell,Combustion Engineering,Daniel Industries,Delta,Dieterich Standard,Dohrmann,
Endress+Hauser,Elsag Bailey,Fisher Controls,Foxboro,Fuji,ABB,Honeywell,ITT Barton,Kay Ray/Sensall,ABB,
Leeds & Northrup,Leslie,M-System,Measurex,Micro Motion,Moore Industries,Moore Products,Ohkura Electric,Paine,
Rochester Instrument Systems,Ronan,Rosemount,Peek Measurement,Schlumberger,Sensall,Siemens,Weed,Toshiba,
Transmation,Rosemount Analytic,Metso,Flowserve,Varec,Viatran,Delta/Weed,Westinghouse,Xomox,Yamatake,Yokogawa,
Nuovo Pignone,Promac,Exac,Mobrey,Arcom,Princo,Smar,Foxboro Eckardt,Measurement Technology,
Applied System Technologies,Samson,Sparling,Fireye,Krohne,Betz,Druck,SOR,Elcon,EMCO,Termiflex,VAF Instruments,
Westlock Controls,Drexelbrook,Saab Tank Control,K-TEK,Flowdata,Draeger,Raytek,Siemens Milltronics,BTG,Magnetrol,
Metso,Milltronics,Helios,Anderson Instrument,INOR,Robertshaw,Pepperl+Fuchs,Accutech,Flow Measurement,Kamstrup,
Knick,VEGA,MTS Systems,Oval,Masoneilan-Dresser,Besta,Ohmart,Harold Beck and Sons,Rittmeyer,Rossel Messtechnik,WIKA,
Bopp & Reuther Heinrichs,PR electronics,Jordan Controls,Valcom,US Electric Motors,Apparatebau Hundsbach,Dynisco,
Spriano,Direct Measurement,Klay Instruments,Action Instruments,MMG,Buerkert,Aaliant,Pondus,ZAP,GLI,
Fisher-Rosemount Performance Technologies,Paper Machine Components,LABOM,Danfoss,Turbo,Tokyo Keiso,SMC,
Status Instruments,Huakong,Duon System,Vortek Instruments,AG Crosby,Action Instruments,Keystone Controls,
Thermo Electric,ISE-Magtech,Rueger,Mettler Toledo,Det-Tronics,TN Technologies,DeZurik,Phase Dynamics,
Welltech Shanghai,Enraf,4tech,Brandt Instruments,Nivelco,Camille Bauer,Metran,Milton Roy,PMV,Turck,Panametrics,
Stahl,Analytical Technology,Fieldbus International,Berthold,InterCorr,China Briconte,Electron Machine,
Sierra Instruments,Fluid Components"""
_NAMES: Final = tuple(_MAKERS.replace("\n", "").split(","))


def maker_text(code: int) -> str:
    """The name of the maker and its ``code`` (0..65535), or "unknown" and the code."""
    number = f"0x{code:02X}" if code < 0x100 else f"0x{code:04X}"
    return f"{_NAMES[code - 1]} ({number})" if 1 <= code <= len(_NAMES) else f"unknown ({number})"


# --- texts and dates ---
_BLANK: Final = 0x20


def unpack_ascii(octets: bytes) -> str:
    """Packed ASCII: 4 characters in 3 octets, 6 bits each; trailing blanks are cut. Raises PduError."""
    if len(octets) % 3:
        raise PduError(f"packed ASCII of {len(octets)} octets: 4 characters stand in 3 octets")
    bits = int.from_bytes(octets, "big")
    count = len(octets) * 8 // 6
    codes = [bits >> 6 * (count - 1 - at) & 0x3F for at in range(count)]
    return "".join(chr(code if code >= _BLANK else code | 0x40) for code in codes).rstrip()


def pack_ascii(text: str, characters: int) -> bytes:
    """``text`` in packed ASCII, filled with blanks to ``characters`` (a multiple of 4). Raises PduError."""
    wrong = next((letter for letter in text if not _BLANK <= ord(letter) <= 0x5F), None)
    if wrong is not None:
        raise PduError(f"{text!r}: packed ASCII has capital letters, digits and signs from blank to _, not {wrong!r}")
    if len(text) > characters:
        raise PduError(f"{text!r} has {len(text)} characters, {characters} are possible")
    bits = 0
    for letter in text.ljust(characters):
        bits = bits << 6 | ord(letter) & 0x3F
    return bits.to_bytes(characters * 6 // 8, "big")


def latin_text(octets: bytes) -> str:
    """A text in Latin-1; it ends before the first zero, trailing blanks are cut."""
    return octets.split(b"\0")[0].decode("latin-1").rstrip()


def date_text(octets: bytes) -> str:
    """Day, month and year - 1900 as ``2026-03-31``; octets that are no date as they are, in hex."""
    day, month, year = octets
    try:
        return datetime.date(1900 + year, month, day).isoformat()
    except ValueError:
        return f"no date ({octets.hex(' ').upper()})"
