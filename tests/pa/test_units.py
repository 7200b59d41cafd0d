"""Unit codes of PROFIBUS PA, held to the makers' printed lists; and what a person types."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dpstack.pa.units import find_unit, unit_name, units

#: code and unit as the makers print them: the symbol in the maker's spelling
PRINTED = {
    # Emerson Micro Motion, configuration and use manual with PROFIBUS, tables D-11 and D-12, p191
    1048: "gal",
    1038: "l",
    1049: "ImpGal",
    1034: "m3",
    1036: "cm3",
    1051: "bbl",
    1043: "ft3",
    1053: "SCF",
    # Endress+Hauser, Proline Promass A 100 PROFINET p56 (the codes of the PA profile)
    1610: "Pa a",
    1616: "kPa a",
    1614: "MPa a",
    1137: "bar",
    1611: "Pa g",
    1617: "kPa g",
    1615: "MPa g",
    1001: "°C",
    1002: "°F",
    1000: "K",
    1003: "°R",
    1342: "%",
    # Siemens SIPROCESS GA700 (A5E31930478-05) p300
    1561: "vpm",
    1566: "mg/m³",
    # hablix/AcyclicProfibusCommunication, alfredkrohmer/profibus-browser
    1138: "mbar",
}


@pytest.mark.parametrize(("code", "printed"), PRINTED.items(), ids=str)
def test_makers_lists(code: int, printed: str) -> None:
    assert find_unit(printed) == code


@pytest.mark.parametrize(
    ("code", "printed"),
    # Promass A 100 p56 prints a blank in these two; the profile has none
    [(1142, "psi a"), (1143, "psi g")],
)
def test_blanks_do_not_count(code: int, printed: str) -> None:
    assert unit_name(code) == printed.replace(" ", "")
    assert find_unit(printed) == code


def test_whole_table() -> None:
    assert [*units()] == [*range(1000, 1521), *range(1551, 1646)]
    assert all(unit.symbol == unit.symbol.strip() and unit.name == unit.name.strip() for unit in units().values())
    assert len({unit.name for unit in units().values()}) == len(units()) - 1  # W/m² is 1308 and 1375
    assert {letter for unit in units().values() for letter in unit.symbol if not letter.isascii()} == set("²³µΩ°Å·é")


@pytest.mark.parametrize(
    ("code", "shown"),
    [
        (1349, "m³/h"),
        (1552, "µS/cm"),
        (1281, "Ω"),
        (1422, "pH"),
        (1590, "Nm³/h"),
        (1997, ""),
        (1995, "unit as text"),
        (1998, "unit unknown"),
        (65531, ""),
        # Emerson prints Nm3 here, Jannusch "vendor-specific": the number says what is known
        (1521, "maker's unit 1521"),
        # Promass A 100 p56: bar g
        (32797, "maker's unit 32797"),
        (1646, "unit 1646"),
        (2000, "unit 2000"),
        (0, "unit 0"),
        (-1, "unit -1"),
        (1 << 40, f"unit {1 << 40}"),
    ],
)
def test_shown(code: int, shown: str) -> None:
    assert unit_name(code) == shown


@pytest.mark.parametrize(
    ("typed", "code"),
    [
        ("m3/h", 1349),
        ("m³/h", 1349),
        ("uS/cm", 1552),
        ("μS/cm", 1552),  # the Greek letter
        ("degC", 1001),
        ("°C", 1001),
        ("l/s", 1351),
        ("L/s", 1351),
        ("ml/min", 1563),
        ("Nl/h", 1594),
        ("hl", 1041),
        ("Ohm", 1281),
        ("kWh", 1179),
        ("mW", 1191),
        ("MW", 1189),
        ("inH2O (4 °C)", 1147),
        ("pH", 1422),
        ("cm3", 1036),
        ("mg/l", 1558),
        ("cubic metre per hour", 1349),
        ("Percent", 1342),
        (" 1138 ", 1138),
        ("40000", 40000),
        ("70000", None),
        ("furlong", None),
        ("", None),
        ("²", None),
    ],
)
def test_typed(typed: str, code: int | None) -> None:
    assert find_unit(typed) == code


@given(st.integers(), st.text(max_size=12))
def test_never_raises(code: int, text: str) -> None:
    assert unit_name(code).isprintable()
    found = find_unit(text)
    assert found is None or 0 <= found <= 0xFFFF


def test_there_and_back() -> None:
    for code, unit in units().items():
        again = find_unit(unit.symbol)
        assert again is not None
        assert unit_name(again) == unit.symbol
        assert find_unit(unit.name) in (code, 1308)
