"""The tables of docs/explanation/hardware.md: rates by the divisors, drivers by the kit with the kernel.

Run this file to write them anew.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

from vm_table import page_block, stored

PAGE = Path(__file__).resolve().parent.parent / "docs" / "explanation" / "hardware.md"
RATES = (9_600, 19_200, 45_450, 93_750, 187_500, 500_000, 1_500_000, 3_000_000, 6_000_000, 12_000_000)
_TABLE = re.compile(r"(<!-- table: rates -->\n[^\n]*\n\|[-|]+\n)((?:\|[^\n]*\n)*)")
_DRIVERS = re.compile(r"(<!-- table: drivers -->\n)(.*?)(<!-- end: drivers -->)", re.DOTALL)
#: AN205, table 1 (cp210x.c): rate, and the highest wish that gets it
_CP2102 = (
    *((9_600, 9_612), (14_400, 14_428), (16_000, 16_062), (19_200, 19_250), (28_800, 28_912), (38_400, 38_601)),
    *((51_200, 51_558), (56_000, 56_280), (57_600, 58_053), (64_000, 64_111), (76_800, 77_608), (115_200, 117_028)),
    *((128_000, 129_347), (153_600, 156_868), (230_400, 237_832), (250_000, 254_234), (256_000, 273_066)),
    *((460_800, 491_520), (500_000, 567_138), (576_000, 670_254), (921_600, 1_000_000)),
)


def ft232r(rate: int) -> float | None:
    eighths = round(24e6 / rate)
    return 24e6 / eighths if eighths == 8 or eighths >= 16 else None


def ft232h(rate: int) -> float | None:
    eighths = round(96e6 / rate)
    return 96e6 / eighths if eighths == 8 or eighths >= 16 else None


def ch341(rate: int) -> float | None:
    """As ch341.c: the highest clock that gives a divisor below 512; halved where the divisor is not from 9 to 255."""
    if rate > 3_000_000:
        return None
    clock = next(1 << k for k in (2, 5, 8, 11) if rate > 48_000_000 // (512 << k))
    divisor = 48_000_000 // (clock * rate)
    if divisor < 9 or divisor > 255:
        clock, divisor = clock * 2, divisor // 2
    return min((48e6 / (clock * n) for n in (divisor, divisor + 1)), key=lambda real: abs(real - rate))


def cp2102(rate: int) -> float | None:
    real = next((real for real, wish in _CP2102 if rate <= wish), None)
    return None if real is None or abs(real / rate - 1) > 0.05 else real


def cp2102n(rate: int) -> float | None:
    return 24e6 / round(24e6 / rate) if rate <= 3_000_000 else None


def pl2303(rate: int) -> float | None:
    """Of the HXD; the rates of its list are made as they are."""
    if rate in {9_600, 19_200, 3_000_000, 6_000_000}:
        return rate
    mantissa, exponent = 384_000_000 // rate, 0
    while mantissa >= 512:
        mantissa, exponent = mantissa // 4, exponent + 1
    return 384e6 / (mantissa << 2 * exponent)


def pl011(rate: int) -> float | None:
    parts = round(48e6 * 4 / rate)
    return 48e6 * 4 / parts if parts >= 64 else None


CHIPS: dict[str, Callable[[int], float | None]] = {
    "FT232R": ft232r,
    "FT232H, FT4232H": ft232h,
    "CH340, CH341": ch341,
    "CP2102": cp2102,
    "CP2102N": cp2102n,
    "PL2303 (HXD)": pl2303,
    "Raspberry Pi PL011": pl011,
}


def error(rate: int, real: float | None) -> str:
    return "-" if real is None else f"{100 * (real / rate - 1):.2f}".replace("-0.00", "0.00")


def rows() -> str:
    cells = {chip: " | ".join(error(rate, of(rate)) for rate in RATES) for chip, of in CHIPS.items()}
    return "".join(f"| {chip} | {errors} |\n" for chip, errors in cells.items())


def test_the_table_of_rates_is_computed() -> None:
    found = _TABLE.search(PAGE.read_text(encoding="utf-8"))
    assert found is not None
    assert found[2] == rows(), "run tests/test_hardware_page.py"


def test_the_table_of_drivers_is_that_of_the_kit() -> None:
    """tests/strangers/kernel compares the stored table with the kernel's own drivers."""
    found = _DRIVERS.search(PAGE.read_text(encoding="utf-8"))
    assert found is not None
    assert found[2] == page_block(stored()), "run tests/test_hardware_page.py"


def test_the_chips_of_the_kit_have_the_rates_of_their_formulas() -> None:
    """The table of rates above is computed without the kit."""
    chips = stored()["chips"]
    for name, formula in (("ft232r", ft232r), ("ft232h", ft232h), ("ch340", ch341), ("cp2102n", cp2102n)):
        close = [rate for rate in (*RATES, 31_250) if (real := formula(rate)) and abs(real / rate - 1) < 0.02]
        assert chips[name]["made"] == sorted(close)


if __name__ == "__main__":
    page = PAGE.read_text(encoding="utf-8")
    page = _TABLE.sub(lambda match: match[1] + rows(), page)
    PAGE.write_text(_DRIVERS.sub(lambda match: match[1] + page_block(stored()) + match[3], page), encoding="utf-8")
