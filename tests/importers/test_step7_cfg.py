"""The reader of STEP 7 exports: line kinds, blocks in blocks, quotes, code pages, damage."""

from __future__ import annotations

import pytest
from step7_kit import CABINET, CPU, GATE, HEAD, PLANT, RACK_IO, STATION, SYSTEM, export_of, section

from dpstack.dp.slot_map import Direction
from dpstack.errors import ConfigError
from dpstack.importers.step7_cfg import Area, Export, Remark, Section, Symbol, read_cfg


def slot(export: Export, address: int, number: int) -> Section:
    return next(one for one in export.sections if (one.place("DPADDRESS"), one.place("SLOT")) == (address, number))


def test_heads_options_and_keys() -> None:
    export = export_of()
    assert export.version == "V5.6 + SP2"
    assert not export.remarks
    assert not export.cut
    assert [one.kind for one in export.sections[:4]] == ["STATION", "SUBNET", "RACK", "DPSUBSYSTEM"]
    station, subnet, cpu, _ = export.sections[:4]
    assert (station.text(0), subnet.keys["TYPE"], subnet.keys["PROFIBUS_BAUDRATE"]) == (
        "Mischerei",
        "PROFIBUS",
        "1.5_MBPS",
    )
    assert cpu.places == {"RACK": 0, "SLOT": 2, "SUBSLOT": 1}
    assert (cpu.texts, cpu.firmware) == (["6ES7 315-2AH14-0AB0", "DP"], "V3.3")
    assert cpu.options == ["AUTOCREATED", 'MASTER DPSUBSYSTEM 1, "PROFIBUS(1)", DPADDRESS 2']


def test_addresses_symbols_and_parameters_of_a_slot() -> None:
    found = slot(export_of(), 12, 5)
    assert found.areas == [Area(Direction.INPUT, 336, 0, 16, found.areas[0].line)]
    assert found.symbols[0] == Symbol(Direction.INPUT, 1, "T_Lager", "Temperatur Lager", found.symbols[0].line)
    assert found.parameters == {"AI_TYPE"}
    assert found.channels == {"AI"}
    assert slot(export_of(), 12, 4).symbols[0].comment == 'Tor "Nord" zu'  # quotes are doubled


def test_blocks_in_blocks_and_addresses_in_a_block_of_their_own() -> None:
    text = (
        'DPSUBSYSTEM 1, DPADRESS 3, SLOT 6, "6ES7 326-1BK01-0AB0" "V2.0", "FDI24"\nBEGIN \n  REDUNDANCY\n  BEGIN\n'
        '    COMMENT "inside"\n  END\n  COMMENT "outside"\n  LOCAL_IN_ADDRESSES\n  BEGIN\n'
        "    ADDRESS  7, 0, 10, 5, 1, 0\n"
        '  END\n  LOCAL_OUT_ADDRESSES\n  BEGIN\n    ADDRESS  8, 0, 4, 5, 1, 0\n  END\n  SYMBOL  I , 0, "a", "b"\nENDE\n'
    )
    (found,) = read_cfg(text.encode()).sections
    assert found.places == {"DPSUBSYSTEM": 1, "DPADDRESS": 3, "SLOT": 6}
    assert found.keys["COMMENT"] == "outside"
    assert [(area.direction, area.address, area.octets) for area in found.areas] == [
        (Direction.INPUT, 7, 10),
        (Direction.OUTPUT, 8, 4),
    ]
    assert found.firmware == "V2.0"


def test_a_comment_of_several_lines_is_one_text() -> None:
    text = section('DPSUBSYSTEM 1, DPADDRESS 3, "A.GSD", "x"', 'COMMENT "first', 'second"', 'WD_ON "1"')
    found = read_cfg(text.encode()).sections[0]
    assert (found.keys["COMMENT"], found.keys["WD_ON"]) == ("first\nsecond", "1")


def test_a_quote_that_is_never_closed_ends_with_its_line() -> None:
    text = section(
        'DPSUBSYSTEM 1, DPADDRESS 3, "A.GSD", "x"', 'COMMENT "first', 'WD_ON "1"', *('SYMBOL I, 0, "a", "b"',)
    )
    found = read_cfg(text.encode()).sections[0]
    assert found.keys["COMMENT"] == "first"
    assert found.keys["WD_ON"] == "1"
    assert [one.name for one in found.symbols] == ["a"]


@pytest.mark.parametrize("encoding", ["cp1252", "utf-8", "utf-8-sig", "utf-16"])
def test_latin_and_unicode_files(encoding: str) -> None:
    export = export_of(encoding=encoding)
    assert slot(export, 10, 2).symbols[0].name == "Füllstand"
    assert export.encoding in (encoding, "cp1252")


CYRILLIC = PLANT.replace("Füllstandsmessung B13", "Уровень в баке B13").replace("Füllstand", "LT31").replace("ö", "o")
CYRILLIC = CYRILLIC.replace("betätigt", "нажата").replace('"frei"', '"Ёмкость ""3"" закрыта"')


def test_cyrillic_projects_have_cp1251() -> None:
    export = export_of(CYRILLIC, "cp1251")
    assert export.encoding == "cp1251"
    assert slot(export, 10, 2).symbols[0].comment == "Уровень в баке B13"
    assert slot(export, 14, 1).symbols[0].comment == 'Ёмкость "3" закрыта'


def test_another_code_page_is_given_by_hand() -> None:
    octets = PLANT.replace("Füllstand", "Poziom_ż").encode("cp1250")
    assert slot(read_cfg(octets, "cp1250"), 10, 2).symbols[0].name == "Poziom_ż"
    with pytest.raises(ConfigError, match="no code page is called 'klingon'; give for instance --encoding cp1251"):
        read_cfg(octets, "klingon")
    with pytest.raises(ConfigError, match="is not utf-8 text"):
        read_cfg(octets, "utf-8")


@pytest.mark.parametrize(
    ("octets", "why"),
    [
        (b"", "has no section of a STEP 7 export"),
        (b"[bus]\nport = 1\n", "has no section of a STEP 7 export"),
        (b"#Profibus_DP\nGSD_Revision = 3\n", "choose Station > Export with the format Readable"),
        (b"PK\x03\x04" + bytes(200), "is binary"),
        (bytes(range(256)) * 4, "is binary"),
        (b"\x89PNG\r\n\x1a\nxyz", "has no section"),
    ],
)
def test_no_export_at_all_is_one_line(octets: bytes, why: str) -> None:
    with pytest.raises(ConfigError, match=why) as caught:
        read_cfg(octets)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("behind", ['SYMBOL  I , 3, "NA_INT"', "LOCAL_OUT_ADDRESSES", 'SLOT 4, "8DO'])
def test_a_file_that_was_cut_keeps_what_it_has(behind: str) -> None:
    export = export_of(PLANT[: PLANT.index(behind) + len(behind)])
    assert export.cut == export.sections[-1].line
    assert [remark.line for remark in export.remarks if "was cut" in remark.text] == [export.cut]
    assert slot(export, 10, 2).symbols[0].name == "Füllstand"


def test_a_section_without_end_does_not_swallow_the_next_one() -> None:
    text = HEAD + STATION + SYSTEM + CABINET[: CABINET.rindex("END")] + RACK_IO + CPU + GATE
    export = export_of(text)
    assert [one.text for one in export.remarks] == [f"this section has no END; it was read up to line {line_of(text)}"]
    assert slot(export, 12, 5).symbols
    assert not export.cut


def line_of(text: str) -> int:
    return text[: text.index("DPADDRESS 12")].count("\r\n")


def test_lines_that_nobody_understands_are_named_and_then_counted() -> None:
    text = section(
        'DPSUBSYSTEM 1, DPADDRESS 3, "A.GSD", "x"', *["?!"] * 25, "SYMBOL I, x", "LOCAL_IN_ADDRESSES", "ADDRESS x"
    )
    export = read_cfg(text.encode())
    assert len(export.remarks) == 21
    assert export.remarks[0] == Remark(7, "not understood: ?!")
    assert export.remarks[-1] == Remark(0, "7 more lines were not understood")


def test_a_section_that_nobody_understands_is_one_remark() -> None:
    foreign = 'CONNECTION S7, "plant"\r\nBEGIN \r\n  LOCAL_ID "1"\r\nBEGIN \r\n  X "1"\r\nEND \r\nEND \r\n\r\n'
    export = export_of(HEAD + STATION + foreign + SYSTEM + foreign + CABINET)
    assert [one.text for one in export.remarks] == ['not understood: CONNECTION S7, "plant"'] * 2
    assert slot(export, 10, 2).symbols
    assert [one.text for one in export_of(f"BEGIN\r\n{STATION}").remarks] == ["not understood: BEGIN"]
    broken = export_of(HEAD + foreign[: foreign.index("END")] + SYSTEM + CABINET)
    assert slot(broken, 10, 2).symbols
