"""Search in GSD files by words, and the file of a device by its order number, whose placeholders fit any character."""

from __future__ import annotations

from pathlib import Path

import pytest

from dpstack.api.gsd_folder import GsdFolder
from dpstack.errors import UsageError
from dpstack.gsd.search import order_number_fits

FILE = """#Profibus_DP
GSD_Revision = 3
Vendor_Name = "{vendor}"
Model_Name = "{model}"
OrderNumber = "{order}"
Ident_Number = {ident}
{modules}"""


def write(folder: Path, name: str, modules: str = "", **keys: str) -> None:
    given = {"vendor": "Nobody & Sons", "model": "Island", "order": "", "ident": "0x1234"} | keys
    parts = (f'Module = "{module}" 0x10\nEndModule\n' for module in filter(None, modules.split("|")))
    (folder / name).write_text(FILE.format(modules="".join(parts), **given), encoding="cp1252")


@pytest.fixture
def folder(tmp_path: Path) -> GsdFolder:
    write(tmp_path, "is01.gse", "131-4BD01 4 DI|131-4BF01 8DI DC24V|132 24DO", order="6ES7 151-1BA0*-0AB0")
    write(tmp_path, "is01.gsg", "131-4BD01 4 DI|131-4BF01 8DI DC24V|132 24DO", order="6ES7 151-1BA0*-0AB0")
    write(tmp_path, "is02.gsd", "131-4BD01 4 DI", order="6ES7 151-1BA02-0AB0", model="Island 2", ident="0x80E0")
    write(tmp_path, "drive.gsd", model="Convertidor   F5", vendor="Otra", order="6SL3040-0xA00-0xxx", ident="0x0696")
    (tmp_path / "broken.gsd").write_bytes(b"\x89PNG\r\n\x1a\n")
    return GsdFolder(tmp_path)


def found(folder: GsdFolder, *words: str) -> list[tuple[str, list[str]]]:
    return [
        (entry.key, [f"{match.field.title}: {match.text}" for match in one.matches])
        for entry, one in folder.search(words)
        if entry.path is not None
    ]


@pytest.mark.parametrize(
    ("words", "files", "fields"),
    [
        ("island", ["is01.gse", "is01.gsg", "is02.gsd"], ["model: Island"]),
        ("80e0", ["is02.gsd"], ["ident: 0x80E0"]),
        ("0x696", ["drive.gsd"], ["ident: 0x0696"]),
        ("80E0h", ["is02.gsd"], ["ident: 0x80E0"]),
        ("W#16#80e0", ["is02.gsd"], ["ident: 0x80E0"]),
        ("6es7151-1ba03", ["is01.gse", "is01.gsg"], ["order number: 6ES7 151-1BA0*-0AB0"]),
        ("OTRA f5", ["drive.gsd"], ["model: Convertidor   F5", "vendor: Otra"]),
        ("nobody 8di", ["is01.gse", "is01.gsg"], ["vendor: Nobody & Sons", "module: 131-4BF01 8DI DC24V"]),
        ("IS02", ["is02.gsd"], ["file: is02.gsd"]),
        # not in 24DO: a number does not begin within another one
        ("4DO", [], []),
        ("island otra", [], []),
    ],
)
def test_every_word_is_found_in_the_best_field(
    folder: GsdFolder, words: str, files: list[str], fields: list[str]
) -> None:
    hits = found(folder, *words.split())
    assert [file for file, _ in hits] == files
    assert [texts for _, texts in hits[:1]] == ([fields] if files else [])


def test_the_module_with_the_most_words_is_shown(folder: GsdFolder) -> None:
    assert found(folder, "8DI", "131")[0] == ("is01.gse", ["module: 131-4BF01 8DI DC24V"])


def test_a_whole_field_goes_before_a_part_of_it(folder: GsdFolder) -> None:
    assert [file for file, _ in found(folder, "Island 2")] == ["is02.gsd"]
    assert folder.search(["island"])[0][1].score > folder.search(["island"])[-1][1].score


def test_broken_files_are_listed_and_do_not_end_the_search(folder: GsdFolder) -> None:
    assert [Path(path).name for path, _ in folder.bad] == ["broken.gsd"]
    with pytest.raises(UsageError, match="no word to look for"):
        folder.search(["--", ""])


def test_a_file_that_breaks_after_its_head_is_listed_when_it_is_searched(tmp_path: Path) -> None:
    write(tmp_path, "a.gsd")
    folder = GsdFolder(tmp_path)
    (tmp_path / "a.gsd").unlink()
    assert found(folder, "island") == []
    assert [reason for _, reason in folder.bad] == ["No such file or directory"]


@pytest.mark.parametrize(
    ("order_number", "wanted", "fit"),
    [
        ("6ES7 151-1BA02-0AB0", "6ES7 151-1BA02-0AB0", 16),
        ("6ES7 151-1BA0*-0AB0", "6es7151-1ba02-0ab0", 15),
        ("6ES7 132-0BL0.-0XB0", "6ES7 132-0BL01-0XB0", 15),
        ("6ES7 153-1AA00-0XB0", "6ES7 153-1AA00-0AB0", 0),
        ("6SL3040-0xA00-0xxx", "6SL3 040-0PA00-0AA0", 12),
        ("6SN1114-0NB00-0AA1 / 6SN1114-0NB01-0AA0", "6SN1114-0NB01-0AA0", 16),
        ("6SN21*", "6SN2115-0AA00", 5),
        ("6SN21", "6SN2115-0AA00", 0),
        ("???????-?????-????", "6ES7151-1BA02-0AB0", 0),
        ("6ES7 151-1BA02-0AB0", "6ES7 151-1BA0?-0AB0", 15),
        ("", "6ES7151-1BA02-0AB0", 0),
    ],
)
def test_order_numbers_with_placeholders(order_number: str, wanted: str, fit: int) -> None:
    assert order_number_fits(order_number, wanted) == fit
