"""Codes of PROFIBUS PA parameters in words: modes, alarms, features, makers, and the enumerations of the blocks.

Every function takes any number: a code that no table has is shown as a number. Sources, and what is unverified:
docs/reference/decisions/pa.md#codes-of-parameters.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from dpstack.text import did_you_mean

#: bits of TARGET_MODE and of the three octets of MODE_BLK, the highest priority first
MODES: Final[Mapping[int, str]] = {
    0x80: "O/S",
    0x40: "IMan",
    0x20: "LO",
    0x10: "MAN",
    0x08: "AUTO",
    0x04: "CAS",
    0x02: "RCAS",
    0x01: "ROUT",
}
#: the same for people who do not know the short ones
MODE_TITLES: Final[Mapping[int, str]] = {
    0x80: "out of service",
    0x40: "initialisation manual",
    0x20: "local override",
    0x10: "manual",
    0x08: "automatic",
    0x04: "cascade",
    0x02: "remote cascade",
    0x01: "remote output",
}


def mode_words(octet: int) -> str:
    """A mode octet: the mode, several of them (permitted) with commas, ``none`` for 0."""
    return ", ".join(word for bit, word in MODES.items() if octet & bit) or "none"


def find_mode(text: str) -> int | None:
    """The bit of the mode that somebody typed: ``auto``, ``man``, ``o/s`` or ``oos``, ``manual``; None if none is
    meant."""
    wanted = text.strip().lower()
    if wanted in ("oos", "os"):
        return 0x80
    tables = (MODES, MODE_TITLES)
    return next((bit for table in tables for bit, word in table.items() if word.lower() == wanted), None)


#: bits of the first octet of an element of ALARM_SUM (current, unacknowledged, unreported, disabled: two octets each)
ALARMS: Final[Mapping[int, str]] = {
    0x01: "discrete alarm",
    0x02: "HI_HI alarm",
    0x04: "HI alarm",
    0x08: "LO_LO alarm",
    0x10: "LO alarm",
    0x80: "parameters changed (update event)",
}


def alarm_words(octets: bytes) -> tuple[str, ...]:
    """The first element of ALARM_SUM, which is all that the profile uses, in words; reserved bits by their number.

    ``octets``: two, or all eight.
    """
    set_bits = (bit for bit in range(16) if int.from_bytes(octets[:2].ljust(2, b"\0"), "little") >> bit & 1)
    return tuple(ALARMS.get(1 << bit, f"alarm bit {bit} (reserved)") for bit in set_bits)


#: bits of the first octet of FEATURE.Supported and FEATURE.Enabled
FEATURES: Final[Mapping[int, str]] = {
    0x01: "condensed status and diagnosis",
    0x02: "classic status and diagnosis",
    0x04: "data exchange broadcast",
    0x08: "class 1 acyclic connection",
    0x10: "PROFIsafe",
}


def feature_words(octets: bytes) -> tuple[str, ...]:
    """One element of FEATURE (four octets) in words; reserved bits by their number."""
    set_bits = (bit for bit in range(32) if int.from_bytes(octets[:4], "little") >> bit & 1)
    return tuple(FEATURES.get(1 << bit, f"feature bit {bit} (reserved)") for bit in set_bits)


def is_condensed(feature: bytes) -> bool | None:
    """Whether FEATURE (eight octets) says that the condensed status is in force; None if it does not say."""
    if len(feature) < 8:
        return None
    enabled = feature[4]
    return bool(enabled & 0x01) if enabled & 0x03 else None


_OFF_ON: Final[Mapping[int, str]] = {0: "off", 1: "on"}
#: words of the enumerations by the parameter's name in the profile
CODES: Final[Mapping[str, Mapping[int, str]]] = {
    "WRITE_LOCKING": {0: "locked", 2457: "not locked"},
    "FACTORY_RESET": {
        0: "nothing",
        1: "reset to defaults",
        2: "reset informational parameters",
        3: "reset functional parameters",
        2506: "restart",
        2712: "reset the bus address",
    },
    "IDENT_NUMBER_SELECTOR": {
        0: "profile",
        1: "maker's",
        2: "maker's (profile 2)",
        3: "profile (multi-variable)",
        127: "adapts to the master",
    },
    "HW_WRITE_PROTECTION": {0: "not protected", 1: "protected, local operation allowed", 2: "protected"},
    "LOCAL_OP_ENA": {0: "disabled", 1: "enabled"},
    "COND_STATUS_DIAG": {0: "classic", 1: "condensed"},
    "POS_D": {0: "not initialised", 1: "closed", 2: "open", 3: "intermediate"},
    "INCREASE_CLOSE": {0: "rising opens", 1: "rising closes"},
    "INVERT": {0: "not inverted", 1: "inverted"},
    "SET_TOT": {0: "totalise", 1: "reset", 2: "preset"},
    "MODE_TOT": {0: "balanced", 1: "positive only", 2: "negative only", 3: "hold"},
    "FAIL_TOT": {0: "run", 1: "hold", 2: "memory"},
    "FSAFE_TYPE": {0: "FSAFE_VALUE", 1: "last usable value", 2: "as calculated, bad"},
    # of an AO or DO block, whose 2 is the actuator's own position
    "FSAFE_TYPE_OUTPUT": {0: "FSAFE_VALUE", 1: "last usable setpoint", 2: "ACTUATOR_ACTION"},
    # of the actuator without supply
    "ACTUATOR_ACTION": {0: "not initialised", 1: "opening", 2: "closing", 3: "none"},
    "CAL_TYPE": {0: "offline", 1: "online"},
    "SIMULATE_ENABLED": _OFF_ON,
    "TAB_OP_CODE": {
        0: "not initialised",
        1: "begin",
        3: "end",
        4: "delete a point",
        5: "insert a point",
        6: "replace a point",
    },
    "TAB_STATUS": {
        0: "not initialised",
        1: "good",
        2: "not monotonous rising, old table",
        3: "not monotonous falling, old table",
        4: "too few values, old table",
        5: "too many values, old table",
        6: "too steep, old table",
        7: "not accepted, old table",
        8: "being loaded",
        9: "being checked",
        20: "not monotonous rising, no table",
        21: "not monotonous falling, no table",
        22: "too few values, no table",
        23: "too many values, no table",
        24: "too steep, no table",
        25: "not accepted, no table",
        26: "being loaded, no table",
        27: "being checked, no table",
    },
    "LIN_TYPE": {
        0: "linear",
        1: "table",
        10: "square root",
        20: "lying cylinder",
        21: "sphere",
        50: "equal percentage 1:33",
        51: "equal percentage 1:33, inverse",
        52: "equal percentage 1:50",
        53: "equal percentage 1:50, inverse",
        54: "equal percentage 1:25",
        55: "equal percentage 1:25, inverse",
        100: "Pt10 IEC 60751",
        101: "Pt50 IEC 60751",
        102: "Pt100 IEC 60751",
        103: "Pt200 IEC 60751",
        104: "Pt500 IEC 60751",
        105: "Pt1000 IEC 60751",
        106: "Pt10 JIS C1604",
        107: "Pt50 JIS C1604",
        108: "Pt100 JIS C1604",
        109: "Pt10 MIL-T-24388",
        110: "Pt50 MIL-T-24388",
        111: "Pt100 MIL-T-24388",
        112: "Pt200 MIL-T-24388",
        113: "Pt500 MIL-T-24388",
        114: "Pt1000 MIL-T-24388",
        115: "Pt100 SAMA RC21-4",
        116: "Pt200 SAMA RC21-4",
        117: "Pt100 IPTS-68",
        118: "Ni50 Edison 7",
        119: "Ni100 Edison 7",
        120: "Ni120 Edison 7",
        121: "Ni1000 Edison 7",
        122: "Ni50 DIN 43760",
        123: "Ni100 DIN 43760",
        124: "Ni120 DIN 43760",
        125: "Ni1000 DIN 43760",
        126: "Cu10",
        127: "Cu100",
        128: "TC type B",
        129: "TC type C",
        130: "TC type D",
        131: "TC type E",
        132: "TC type G",
        133: "TC type J",
        134: "TC type K",
        135: "TC type N",
        136: "TC type R",
        137: "TC type S",
        138: "TC type T",
        139: "TC type L",
        140: "TC type U",
        141: "TC Pt20/Pt40",
        142: "TC Ir/Ir40",
        143: "TC Platinel II",
        144: "TC Ni/NiMo",
    },
}
#: what every enumeration of one octet may have; those of two octets have it at 65280 more
_COMMON: Final[Mapping[int, str]] = {250: "not used", 251: "none", 252: "unknown", 253: "special"}
_WIDE: Final = 0xFF00
_OWN: Final[Mapping[str, range]] = {
    "WRITE_LOCKING": range(0x8000, 0x10000),
    "FACTORY_RESET": range(0x8000, 0x10000),
    "LIN_TYPE": range(240, 250),
}
_OWN_OCTET: Final = range(128, 250)


def code_word(parameter: str, code: int) -> str:
    """``code`` of the enumeration ``parameter`` in words, or as ``maker's 200`` or ``code 7``."""
    word = CODES.get(parameter, {}).get(code) or _COMMON.get(code) or _COMMON.get(code - _WIDE)
    if word is not None:
        return word
    return f"maker's {code}" if code in _OWN.get(parameter, _OWN_OCTET) else f"code {code}"


def find_code(parameter: str, text: str) -> int | None:
    """The code that somebody typed for ``parameter``: its words or the number; None if neither is meant."""
    text = text.strip()
    if text.isascii() and text.isdigit():
        return int(text[:6])
    wanted = text.lower()
    return next((code for code, word in CODES.get(parameter, {}).items() if word.lower() == wanted), None)


def code_hint(parameter: str, text: str) -> str:
    """What to write for ``parameter`` in place of ``text``: ``did you mean ...?``, or all words that are possible."""
    known = list(CODES.get(parameter, {}).values())
    return did_you_mean(text, known, "possible: " + ", ".join(known)) if known else "write a number"


#: DEVICE_MAN_ID: makers of process devices (numbers that the PNO gives out; up to 255 they are those of HART)
MAKERS: Final[Mapping[int, str]] = {
    1: "Acromag",
    5: "ABB",
    10: "Brooks",
    17: "Endress+Hauser",
    18: "ABB",
    19: "Fisher",
    20: "Foxboro",
    21: "Fuji",
    22: "ABB",
    23: "Honeywell",
    26: "ABB",
    31: "Micro Motion",
    38: "Rosemount",
    42: "Siemens",
    44: "Toshiba",
    46: "Rosemount Analytical",
    47: "Metso",
    48: "Flowserve",
    54: "Yamatake (Azbil)",
    55: "Yokogawa",
    59: "Mobrey",
    62: "Smar",
    63: "Foxboro Eckardt",
    66: "Samson",
    69: "Krohne",
    78: "Drexelbrook",
    79: "Saab Tank Control",
    80: "K-TEK",
    82: "Dräger",
    84: "Siemens Milltronics",
    86: "Magnetrol",
    87: "Metso",
    88: "Siemens Milltronics",
    93: "Pepperl+Fuchs",
    96: "Baumer",
    97: "Knick",
    98: "VEGA",
    99: "MTS",
    101: "Masoneilan",
    105: "Rittmeyer",
    106: "Rössel",
    107: "WIKA",
    108: "Bopp & Reuther",
    109: "PR electronics",
    117: "Klay",
    120: "Bürkert",
    127: "Labom",
    128: "Danfoss",
    130: "Tokyo Keiso",
    140: "ISE-Magtech",
    142: "Mettler Toledo",
    148: "Enraf",
    151: "Nivelco",
    155: "PMV",
    157: "Panametrics",
    158: "Stahl",
    161: "Berthold",
    165: "Sierra",
    169: "Invensys",
    176: "Phoenix Contact",
    185: "BD Sensors",
    188: "Aplisens",
    189: "Badger Meter",
    194: "Hengesbach",
    198: "Fafnir",
    199: "Sick Maihak",
    207: "Koso",
    211: "Heinrichs",
    213: "Hach Lange",
    257: "Sick",
    270: "Bartec",
    279: "Softing",
    293: "Rotork",
    299: "Turck",
    310: "ifm electronic",
    317: "Turck",
    319: "AUMA",
    321: "SIPOS",
    323: "ProMinent",
    330: "Grundfos",
    333: "Festo",
    390: "optek-Danulat",
    401: "GEMÜ",
    530: "Emerson",
}


def maker_name(number: int) -> str:
    """The maker by DEVICE_MAN_ID; ``maker 12345`` for one that the table does not have."""
    return MAKERS.get(number, f"maker {number}")
