"""The folders of `dpstack mcp`: no name leads out of them, over "..", absolute paths or links."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from dpstack.cli.assistants.folders import Folders
from dpstack.errors import UsageError

ENDINGS = frozenset((".toml", ".gsd"))


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``in`` and ``more`` are named, ``out`` is not; links lead out of both, in, and from one to the other."""
    top = tmp_path_factory.mktemp("tree")
    for folder in ("in/deep", "in/.hidden", "more", "out", "input"):
        (top / folder).mkdir(parents=True)
    for name in ("in/a.toml", "in/deep/b.gsd", "in/.hidden/h.toml", "more/c.gsd", "out/secret.toml", "input/i.toml"):
        (top / name).write_text("x")
    (top / "in/.env.toml").write_text("x")
    (top / "in/file.link.toml").symlink_to(top / "out/secret.toml")
    (top / "in/folder").symlink_to(top / "out")
    (top / "in/up").symlink_to("..")
    (top / "in/other").symlink_to(top / "more")
    (top / "in/within.toml").symlink_to("a.toml")
    (top / "in/loop.toml").symlink_to("loop.toml")
    os.mkfifo(top / "in/pipe.toml")
    return top


@pytest.fixture(scope="module")
def folders(tree: Path) -> Folders:
    return Folders([tree / "in", tree / "more"])


@pytest.mark.parametrize(
    ("name", "real"),
    [
        ("a.toml", "in/a.toml"),
        ("./deep/../a.toml", "in/a.toml"),
        ("deep/b.gsd", "in/deep/b.gsd"),
        ("c.gsd", "more/c.gsd"),
        ("other/c.gsd", "more/c.gsd"),  # a link from one named folder to another
        ("within.toml", "in/a.toml"),
        ("TREE/more/c.gsd", "more/c.gsd"),
    ],
)
def test_files_within(tree: Path, folders: Folders, name: str, real: str) -> None:
    assert folders.file(name.replace("TREE", str(tree)), ENDINGS) == tree / real


UNKNOWN = "is not in the folders of this server"


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("../out/secret.toml", UNKNOWN),
        ("../out/nothing.toml", UNKNOWN),
        ("deep/../../out/secret.toml", UNKNOWN),
        ("../input/i.toml", UNKNOWN),  # begins as a named folder does
        ("TREE/out/secret.toml", UNKNOWN),
        ("TREE/in/../out/secret.toml", UNKNOWN),
        ("/etc/hostname", UNKNOWN),
        ("~/a.toml", UNKNOWN),
        ("nothing.toml", UNKNOWN),
        ("loop.toml", UNKNOWN),
        (".env.toml", UNKNOWN),
        (".hidden/h.toml", UNKNOWN),
        ("deep/../.hidden/h.toml", UNKNOWN),
        (".", UNKNOWN),
        ("file.link.toml", "is a link that leads out of the folders"),
        ("folder/secret.toml", "is a link that leads out of the folders"),
        ("up/out/secret.toml", "is a link that leads out of the folders"),
        ("deep", "is no ordinary file"),
        ("pipe.toml", "is no ordinary file"),
        ("", "1 to 1000 printable characters"),
        ("a\0.toml", "1 to 1000 printable characters"),
        ("a\n.toml", "1 to 1000 printable characters"),
        ("x" * 1001, "1 to 1000 printable characters"),
    ],
)
def test_what_is_refused_in_one_line(tree: Path, folders: Folders, name: str, why: str) -> None:
    with pytest.raises(UsageError) as raised:
        folders.file(name.replace("TREE", str(tree)), ENDINGS)
    assert why in str(raised.value)
    assert str(raised.value).isprintable()


def test_the_message_does_not_say_whether_a_file_outside_exists(folders: Folders) -> None:
    texts = []
    for name in ("../out/secret.toml", "../out/nosuch.toml"):
        with pytest.raises(UsageError) as raised:
            folders.file(name, ENDINGS)
        texts.append(str(raised.value).replace("secret", "").replace("nosuch", ""))
    assert texts[0] == texts[1]


def test_another_ending_is_refused(folders: Folders) -> None:
    with pytest.raises(UsageError, match=r"'a.toml': this tool reads files that end in .gsd"):
        folders.file("a.toml", {".gsd"})


def test_the_list_has_ordinary_files_only(folders: Folders) -> None:
    assert [one.name for one in folders.files(ENDINGS)] == ["a.toml", "deep/b.gsd", "c.gsd"]


PARTS = st.sampled_from(
    (
        *"./~\\ ",
        *("é", "%2e%2e", "//", "\x7f", "..", "in", "out", "more", "deep", "folder", "up", "other", ".hidden", "TREE"),
        *("a.toml", "c.gsd", "secret.toml", "file.link.toml", "loop.toml"),
        "x" * 300,
    )
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(PARTS, max_size=8), st.sampled_from(["/", "", "//", "/./"]))
def test_any_name_gives_a_file_within_or_an_error(tree: Path, folders: Folders, parts: list[str], between: str) -> None:
    name = between.join(parts).replace("TREE", str(tree))
    allowed = {tree / one for one in ("in/a.toml", "in/deep/b.gsd", "more/c.gsd")}
    place = folders.place(name, ENDINGS)
    assert place is None or place.parent in {tree / "in", tree / "in/deep", tree / "more"}
    with contextlib.suppress(UsageError):
        assert folders.file(name, ENDINGS) in allowed


@pytest.mark.parametrize(("name", "why"), [("nothing", "No such file"), ("in/a.toml", "is no folder")])
def test_a_folder_that_is_none(tree: Path, name: str, why: str) -> None:
    with pytest.raises(UsageError, match=why):
        Folders([tree / name])
