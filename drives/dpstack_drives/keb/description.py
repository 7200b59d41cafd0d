"""The F5's part of the commissioning sheet that depends on its options: words, range, faults; errors of its channel."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final

from msgspec import structs

from dpstack.profile import (
    MADE_UP,
    DescribedCode,
    DescribedMessage,
    DescribedRange,
    DescribedWord,
    DeviceDescription,
    Options,
    Word,
    described_word,
    speed_range,
    states_of,
)
from dpstack_drives.keb import table as t
from dpstack_drives.keb.plugin import KebCore

_SUPERVISION: Final = "Communication Supervision"
#: what has to be done about errors of the parameter channel, as far as the table says it
_REMEDIES: Final = {t.PASSWORD: "write ud.01 = 440", t.BUSY: "repeat the request"}


def describe(core: KebCore, described: DeviceDescription, address: int, options: Options) -> DeviceDescription:
    """The drive of ``core``. Names of bits are those of the options: they are in the inverter's application manual."""
    made_up = str(options["status_bits"]).strip() == t.SIMULATED_BITS
    source = MADE_UP if made_up else "by option"
    table = core.table
    unnamed = "no names yet: give the options control_bits and status_bits, from the inverter's application manual"
    trips = t.TRIPS if made_up else {"E.buS": t.E_BUS}
    rpm = float(options["rpm_per_count"])
    return structs.replace(
        described,
        words=tuple(
            structs.replace(described_word(word, states_of(table) if word is table.status else ()), name=name)
            if word.bits
            else DescribedWord(name=name, codes=(DescribedCode("bits", unnamed),))
            for word, name in _words(table.control, table.status, source)
        ),
        ranges=(speed_range(core, "the option rpm_per_count", f"{rpm:g} rpm a count of sy.52 and sy.53"),)
        if rpm
        else (
            DescribedRange(
                name="sy.52 set speed, sy.53 actual speed",
                range="",
                wire="the unit is in the inverter's application manual: give the option rpm_per_count",
                source="the application manual",
            ),
        ),
        faults=tuple(
            DescribedMessage(
                code=name if name == "E.buS" and not made_up else f"{name} (ru.00 = {number})",
                text="watchdog error: no activity on PROFIBUS" if name == "E.buS" else "",
                remedy="Pn.06 is the time, Pn.05 the reaction; Fb.39 and Fb.40 say what the watchdog watches"
                if name == "E.buS"
                else "",
                source=_SUPERVISION if name == "E.buS" else MADE_UP,
            )
            for name, number in trips.items()
        ),
        errors=tuple(
            DescribedMessage(
                code=str(code),
                text=text,
                remedy=_REMEDIES.get(code, ""),
                source="Error messages of the parameterizing channel",
            )
            for code, text in t.ERRORS.items()
        ),
    )


def _words(control: Word, status: Word, source: str) -> Iterator[tuple[Word, str]]:
    yield control, f"sy.50 (control word), bits {source}"
    yield status, f"sy.51 (status word), bits {source}"
