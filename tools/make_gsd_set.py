"""Writes a set of made-up GSD files as large and as odd as the known public ones: 689 files, 18 MB, 676 000 lines.

How often each keyword occurs, how long the largest files are and which oddities stand in how many files follows counts
over those files; every word in them is ours. The same seed makes the same octets.

    python tools/make_gsd_set.py DIR [--files 689] [--seed 1]
"""

from __future__ import annotations

import argparse
import random
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

#: in all 689 files together
FILES: Final = 689
_REFS: Final = 160_770
_PARAMETERS: Final = 36_101
_PRM_TEXTS: Final = 9_618
_MODULES: Final = 24_994
_WITH_PRM: Final = 15_355 / _MODULES
_VALUES: Final = 23_062
_AREAS: Final = 3_491
_DIAG_BITS: Final = 7_353
_BLANK_SHARE: Final = 0.215

_NOUNS: Final = (
    "input",
    "output",
    "channel",
    "filter",
    "sensor",
    "valve",
    "axis",
    "counter",
    "bridge",
    "limit",
    "supply",
)
_ADJECTIVES: Final = (
    "upper",
    "lower",
    "left",
    "digital",
    "analogue",
    "delayed",
    "filtered",
    "internal",
    "spare",
    "fast",
)
_ODD_LETTERS: Final = ("für", "Überlast", "Größe", "réglé", "±5 %", "20 °C")
_OFFS: Final = ("off", "on", "slow", "medium", "fast", "automatic", "by hand", "inverted")
_RATES: Final = ("9.6", "19.2", "45.45", "93.75", "187.5", "500", "1.5M", "3M", "6M", "12M")
_TSDR: Final = (60, 60, 250, 60, 60, 100, 150, 250, 450, 800)
_TYPES: Final = ("Bit", "BitArea", "Unsigned8", "Unsigned16", "Signed16", "Unsigned32", "Signed32")
_TYPE_WEIGHTS: Final = (16_266, 11_576, 3_986, 3_012, 1_118, 133, 10)


@dataclass(frozen=True)
class Size:
    """The numbers of the parts of one file."""

    modules: int
    parameters: int
    prm_texts: int
    refs: int
    areas: int
    values: int
    bits: int
    lines: int = 0


class Maker:
    """One file. ``number`` chooses the oddities it has."""

    def __init__(self, number: int, size: Size, seed: int) -> None:
        self._number = number
        self._size = size
        self._random = random.Random(seed * 100_003 + number)
        self._wide = self._random.random() < 285 / FILES
        self._continued = self._random.random() < 209 / FILES
        self._tabs = self._random.random() < 0.2

    def octets(self) -> bytes:
        text = "\n".join(self._spread(list(self._lines())))
        number = self._number
        if number % 16 != 3:  # 42 files have no line end at their end
            text += "\n"
        ends = "\r\n" if number % 9 else "\n"
        if number == 77:
            ends = "\r\r\n"
        elif number == 78:
            ends = "\r"
        text = text.replace("\n", ends)
        if number % 138 == 5:
            return b"\xef\xbb\xbf" + text.encode("utf-8")
        return text.encode("cp1252")

    def _phrase(self, words: int = 2) -> str:
        rnd = self._random
        parts = [rnd.choice(_ADJECTIVES if n % 2 == 0 else _NOUNS) for n in range(words)]
        if self._wide and rnd.random() < 0.05:
            parts.append(rnd.choice(_ODD_LETTERS))
        if rnd.random() < 0.003:
            parts.append("; see the manual")
        return " ".join(parts)

    def _lines(self) -> Iterator[str]:
        size, number = self._size, self._number
        yield from self._head()
        late = number % 7 == 0  # definitions behind their use
        if not late:
            yield from self._definitions()
        yield from self._diagnosis()
        yield "Ext_User_Prm_Data_Const(0) = 0x00,0x00,0x00,0x00,0x00"
        for n in range(min(3, size.parameters)):
            yield f"Ext_User_Prm_Data_Ref({3 + n}) = {n + 1}"
        yield from self._modules()
        if size.modules > 4 and number % 20 == 0:
            yield "SlotDefinition"
            for slot in range(1, 9):
                yield f'Slot({slot}) = "place {slot}" 1 1-{size.modules}'
            yield "EndSlotDefinition"
        if late:
            yield from self._definitions()

    def _head(self) -> Iterator[str]:
        rnd, number, size = self._random, self._number, self._size
        if number % 12 == 2:
            yield "; a made-up device; no maker wrote this file"
        mark = "#PROFIBUS_DP" if number % 69 == 4 else "#Profibus_DP"
        yield mark + (" ; begins here" if number % 27 == 6 else "")
        if number % 172 != 9:
            yield f"GSD_Revision = {rnd.choices((1, 2, 3, 4, 5), (42, 78, 110, 365, 59))[0]}"
        yield 'Vendor_Name = "Nobody & Sons"'
        yield f'Model_Name = "{self._phrase(3)} {number}"'
        yield 'Revision = "A01"'
        yield f"Ident_Number = 0x{0x1000 + number % 211:04X}"
        yield from ("Protocol_Ident = 0", "Station_Type = 0", "FMS_supp = 0", 'Hardware_Release = "1.1"')
        yield 'Software_Release = "V2.0 ; first"' if number % 8 == 1 else 'Software_Release = "V2.0"'
        for rate, tsdr in zip(_RATES, _TSDR, strict=True):
            yield f"{rate}_supp = 1"
            yield f"MaxTsdr_{rate} = {tsdr}"
        yield from ("Redundancy = 0", "Repeater_Ctrl_Sig = 2", "24V Pins = 0" if number % 99 == 8 else "24V_Pins = 0")
        yield from (
            'Implementation_Type = "own"',
            'Bitmap_Device = "none"',
            "Freeze_Mode_supp = 1",
            "Sync_Mode_supp = 1",
        )
        yield "Auto_Baud_Supp = 1" if number % 5 == 0 else "Auto_Baud_supp = 1"
        yield from (
            "Set_Slave_Add_supp = 0",
            "Min_Slave_Intervall = 6",
            "Fail_Safe = 1",
            "Slave_Family = 3@made up@set",
        )
        yield from (f"Modular_Station = {int(size.modules > 1)}", "Max_Module = 32", "Max_Input_Len = 244")
        yield from (
            "Max_Output_Len = 244",
            "Max_Data_len = 488",
            "Max_Diag_Data_Len = 64",
            "Max_User_Prm_Data_Len = 237",
        )
        if number % 4 == 0:
            yield from (
                "DPV1_Slave = 1",
                "C1_Read_Write_supp = 1",
                "C1_Max_Data_Len = 240",
                "C1_Response_Timeout = 100",
            )
            yield from ("Diagnostic_Alarm_supp = 1", "Check_Cfg_Mode = 1", "WD_Base_1ms_supp = 1")

    def _definitions(self) -> Iterator[str]:
        rnd, size = self._random, self._size
        per_text = max(1, round(52_685 / _PRM_TEXTS))
        for n in range(1, size.prm_texts + 1):
            yield f"PrmText = {n}"
            for value in range(rnd.randint(2, 2 * per_text - 2)):
                yield f'Text({value}) = "{rnd.choice(_OFFS)} {self._phrase(1)}"'
            yield "EndPrmText"
        for n in range(1, size.parameters + 1):
            yield f'ExtUserPrmData = {n} "{self._phrase()}"'
            with_text = size.prm_texts and rnd.random() < 29_928 / _PARAMETERS
            yield self._type(bool(with_text))
            if with_text:
                yield f"Prm_Text_Ref = {rnd.randint(1, size.prm_texts)}"
            yield "EndExtUserPrmData"

    def _type(self, with_text: bool) -> str:
        rnd = self._random
        kind = rnd.choices(_TYPES, _TYPE_WEIGHTS)[0]
        match kind:
            case "Bit":
                bit = rnd.randrange(8)
                return f"Bit({bit}) {rnd.randrange(2)} " + ("0,1" if rnd.random() < 0.3 else "0-1")
            case "BitArea":
                first = rnd.randrange(6)
                return f"BitArea({first}-{first + 1}) {rnd.randrange(4)} 0-3"
            case "Unsigned8":
                return "UNSIGNED8 1 0-255" if rnd.random() < 0.02 else f"Unsigned8 {rnd.randrange(8)} 0-255"
            case "Unsigned16":
                return "Unsigned16 0x4802 0-0xffff" if rnd.random() < 0.1 else "Unsigned16 24 24 - 48000"
            case "Signed16":
                return "Signed16 -32768 -32768-32767"
            case "Signed32":
                return "Signed32 0 -16777216-16777215"
        return f"Unsigned32 {1 if with_text else 1000} 0-100000"

    def _diagnosis(self) -> Iterator[str]:
        size, rnd = self._size, self._random
        for bit in range(size.bits):
            keyword = ("Unit_Diag_Bit", "X_Unit_Diag_Bit")[bit % 4 == 3]
            yield (
                f'{keyword}({24 + bit:04d}) = "{self._phrase(3)}"'
                if bit % 50 == 9
                else (f'{keyword}({24 + bit}) = "{self._phrase(3)}"')
            )
            if rnd.random() < 0.3:
                yield f'{keyword}_Help({24 + bit}) = "{self._phrase(5)}"'
        left = size.values
        for area in range(size.areas):
            x = "X_" * (area % 2)
            yield f"{x}Unit_Diag_Area = {8 * area}-{8 * area + 7}"
            take = left // (size.areas - area)
            left -= take
            for value in range(take):
                yield f'{x}Value({value}) = "{self._phrase(3)}"'
            yield f"{x}Unit_Diag_Area_End"
        if self._number % 3 == 0:
            for error in range(16, 16 + 6):
                yield f'Channel_Diag({error}) = "{self._phrase()}"'
        if self._number % 12 == 0:
            yield from ("UnitDiagType = 129", 'X_Unit_Diag_Bit(24) = "parity"', "EndUnitDiagType")
        if self._number % 70 == 1:
            yield 'Unit_Diag_!Bit( 5 ) = "no load voltage"'
            yield "Physical_Interface = 0"
            yield "End_Physical_Interface"

    def _modules(self) -> Iterator[str]:
        size, rnd = self._size, self._random
        refs, with_prm = size.refs, max(1, round(size.modules * _WITH_PRM))
        family: list[str] = []
        for n in range(1, size.modules + 1):
            yield f'Module = "{self._phrase(3)} {n}" {self._config()}'
            if rnd.random() < 0.88:
                yield f"{n}"
            if with_prm and rnd.random() < _WITH_PRM + 0.05:
                take = min(refs, max(1, refs // with_prm))
                with_prm -= 1
                refs -= take
                if len(family) != take or rnd.random() < 0.4:
                    first = rnd.randint(1, max(1, size.parameters - take))
                    family = [
                        f"Ext_User_Prm_Data_Ref({3 + at * 2 // 3}) = {min(size.parameters, first + at)}"
                        for at in range(take if size.parameters else 0)
                    ]
                length = min(200, 7 + take)
                yield f"Ext_Module_Prm_Data_Len = {length}"
                yield f"Ext_User_Prm_Data_Const(0) = {self._octets(length)}"
                yield from family
            if rnd.random() < 0.04:
                yield f'Info_Text = "{self._phrase(6)}"'
            yield "ENDMODULE" if rnd.random() < 0.001 else "EndModule"

    def _octets(self, count: int) -> str:
        values = [f"0x{self._random.randrange(256):02X}" for _ in range(count)]
        if self._continued and self._random.random() < 0.2 and count > 4:
            values[3] = "\\ ; on the next line\n" + values[3] if self._random.random() < 0.15 else "\\\n" + values[3]
        return ",".join(values)

    def _config(self) -> str:
        rnd = self._random
        draw = rnd.random()
        if draw < 0.156:
            return "0x00"
        if draw < 0.332:
            return "0x42,0x00,0x08,0x02" if rnd.random() < 0.5 else "0xC1, 0x01, 0x03, 0x11"
        return rnd.choice(("0x10", "0x20", "0x11,0x21", "0xF3,0xF1", "0x50", "80", "0X60"))

    def _spread(self, lines: list[str]) -> Iterator[str]:
        """Blank and comment lines between, tabs in some files; filled up to the size asked for."""
        rnd = self._random
        more = max(0, self._size.lines - len(lines)) if self._size.lines else 0
        for n, line in enumerate(lines):
            yield ("\t" + line if self._tabs and not line.startswith("#") else line)
            if self._size.lines:
                if n * more // len(lines) != (n + 1) * more // len(lines):
                    yield ""
            elif rnd.random() < _BLANK_SHARE:
                yield "" if rnd.random() < 0.6 else f"; ---- {self._phrase(3)} ----"


def sizes(files: int, seed: int) -> list[Size]:
    """The sizes of all files: two as large as the largest known, the rest share the totals unevenly."""
    rnd = random.Random(seed)
    weights = [rnd.lognormvariate(0, 1.1) for _ in range(files)]
    total = sum(weights) * FILES / files
    found = []
    for weight in weights:
        share = weight / total
        found.append(
            Size(
                modules=max(1, round(_MODULES * share * 0.93)),
                parameters=round(_PARAMETERS * share * 0.97),
                prm_texts=round(_PRM_TEXTS * share),
                refs=round(_REFS * share),
                areas=round(_AREAS * share),
                values=round(_VALUES * share),
                bits=min(166, round(_DIAG_BITS * share)),
            )
        )
    if files >= 2:
        found[0] = LARGEST
        found[1] = Size(modules=90, parameters=679, prm_texts=137, refs=1_400, areas=4, values=40, bits=166)
    return found


#: as long as the longest file known
LARGEST: Final = Size(modules=1_295, parameters=150, prm_texts=40, refs=3_000, areas=8, values=60, bits=60, lines=9_372)


def make_file(number: int, size: Size, seed: int = 1) -> bytes:
    """One file of the set."""
    return Maker(number, size, seed).octets()


def make_set(files: int = FILES, seed: int = 1) -> Iterator[tuple[str, bytes]]:
    """(name, octets) of every file."""
    for number, size in enumerate(sizes(files, seed)):
        yield f"made{number:04d}.gsd", make_file(number, size, seed)


def main() -> None:
    parser = argparse.ArgumentParser(description="writes made-up GSD files to measure with")
    parser.add_argument("dir", type=Path)
    parser.add_argument("--files", type=int, default=FILES)
    parser.add_argument("--seed", type=int, default=1)
    args = parser.parse_args()
    args.dir.mkdir(parents=True, exist_ok=True)
    count = octets = lines = 0
    for name, content in make_set(args.files, args.seed):
        (args.dir / name).write_bytes(content)
        count, octets, lines = count + 1, octets + len(content), lines + content.count(b"\n")
    print(f"{count} files, {octets / 1e6:.1f} MB, {lines} lines")


if __name__ == "__main__":
    main()
