"""The GSD file of a device by its order number, as an imported project names it."""

from __future__ import annotations

from pathlib import Path

import pytest

from dpstack.api.gsd_folder import GsdFolder
from dpstack.api.gsd_orders import FolderFinder

FILES = {
    "a.gsg": "6ES7 151-1BA0*-0AB0",
    "a.gse": "6ES7 151-1BA0*-0AB0",
    "b.gsd": "6ES7 151-1BA02-0AB0",
    "c.gsd": "6ES7 132-0BL0.-0XB0",
}


@pytest.mark.parametrize(
    ("number", "files"),
    [
        ("6ES7 151-1BA02-0AB0", ["b.gsd", "a.gse", "a.gsg"]),
        ("6ES7151-1BA03-0AB0", ["a.gse", "a.gsg"]),
        ("6ES7 132-0BL01-0XB0", ["c.gsd"]),
        ("6ES7 000-0AA00-0AB0", []),
    ],
)
def test_fewer_placeholders_go_first_then_english(tmp_path: Path, number: str, files: list[str]) -> None:
    for name, order in FILES.items():
        head = f'#Profibus_DP\nIdent_Number = 1\nOrderNumber = "{order}"\n500_supp = 1\n'
        (tmp_path / name).write_text(head, encoding="cp1252")
    assert [found.key for found in FolderFinder(GsdFolder(tmp_path)).with_order(number)] == files
