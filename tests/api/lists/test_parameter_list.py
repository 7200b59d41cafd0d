"""Parameter lists: the file to the letter, dump and compare of every drive, and what comes in between."""

from __future__ import annotations

import asyncio
import errno
import os
from dataclasses import replace
from pathlib import Path

import pytest
from api_kit import RAW, bench_of, bus_of, in_operate, virtual
from hypothesis import given
from hypothesis import strategies as st
from support import instance

import dpstack
from dpstack.api.files import AtomicFile
from dpstack.api.lists.list_file import ListComparison
from dpstack.api.lists.parameter_list import ParameterList, SavedParam
from dpstack.errors import ConfigError, UsageError
from dpstack.profile import DriveDevice

pytestmark = pytest.mark.virtual_time

TEXT = """\
# Parameters of a drive; `dpstack drive CONFIG NAME compare FILE` shows where a drive differs.
format = 1
drive = "demag-dedrive"
name = "hoist"
address = 3
time = "2026-01-31T12:00:00Z"
complete = true
parameters = [
  { name = "dp_master_out", number = 281, unreadable = "a \\"text\\"", read_only = true, title = "DP-Master OUT" },
  { name = "fixed_frequency_1", number = 480, data_set = 3, value = -300.0, unit = "Hz", title = "Fixed frequency 1" },
  { name = "F26", number = 260, subindex = 26, index = 0, value = 15, unit = "", title = "Motor sound" },
]
"""
LIST = ParameterList(
    drive="demag-dedrive",
    name="hoist",
    address=3,
    time="2026-01-31T12:00:00Z",
    parameters=(
        SavedParam(name="dp_master_out", number=281, unreadable='a "text"', read_only=True, title="DP-Master OUT"),
        SavedParam(
            name="fixed_frequency_1", number=480, data_set=3, value=-300.0, unit="Hz", title="Fixed frequency 1"
        ),
        SavedParam(name="F26", number=260, subindex=26, index=0, value=15, title="Motor sound"),
    ),
)
DRIVES = {
    "demag-dedrive": (44, "fixed_frequency_1", 7.25, 1),
    "fuji-frenic": (49, "F26", 15, None),
    "imo-hd2": (25, "P00.10", 30.5, None),
    "keb-f5": (115, "oP.03", 20.5, 0),
    "ls-s100": (133, "dr-03", 2.5, None),
}


def slave(kind: str) -> dict[str, object]:
    return {"name": "it", "address": 5, "drive": kind}


def bus_with(kind: str, *more: dict[str, object]) -> dpstack.Bus:
    """At a low rate, where the drive's own time counts: fewer exchanges to compute. The IMO hears one rate only."""
    return dpstack.open_bus(
        port="virtual", baud=1_500_000 if kind == "imo-hd2" else 93_750, slaves=[slave(kind), *more]
    )


def test_the_file_to_the_letter() -> None:
    assert LIST.text() == TEXT
    assert ParameterList.parse(TEXT) == LIST
    assert [one.label for one in LIST.parameters] == ["dp_master_out", "fixed_frequency_1, data set 3", "F26, index 0"]


_texts = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
_numbers = st.integers(0, 0xFFFF)
_maybe = st.none() | st.integers(0, 255)


@given(
    st.lists(
        st.builds(
            SavedParam,
            name=_texts,
            number=_numbers,
            title=_texts,
            subindex=_numbers,
            data_set=_maybe,
            index=_maybe,
            value=st.integers(-(2**31), 2**32) | st.floats(allow_nan=False, allow_infinity=False),
            unit=_texts,
            read_only=st.booleans(),
        ),
        max_size=4,
        unique_by=lambda one: one.place,
    ),
    _texts,
    st.booleans(),
)
def test_a_list_that_was_written_is_read(params: list[SavedParam], name: str, complete: bool) -> None:
    wanted = replace(LIST, parameters=tuple(params), name=name, complete=complete)
    assert ParameterList.parse(wanted.text()) == wanted


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("format = 1", "format = 2", "format = 1 is missing"),
        ("address = 3", 'address = "3"', "address is missing or of the wrong type"),
        ("complete = true", "complete = 1", "complete is missing or of the wrong type"),
        ("address = 3", "address = 3\nnode = 3", "there is no key 'node'"),
        ("value = 15", "value = true", "parameter 3 (F26): value = True is of the wrong type"),
        ("value = 15", "value = nan", "parameter 3 (F26): value = nan is of the wrong type"),
        ("value = 15,", "", "parameter 3 (F26): needs either value or unreadable"),
        ("value = 15", 'value = 15, unreadable = ""', "parameter 3 (F26): needs either value or unreadable"),
        ("subindex = 26", "sub = 26", "parameter 3 (F26): there is no key 'sub'; there are name, number, subindex"),
        ("number = 260, ", "", "parameter 3 (F26): needs name and number"),
        ('name = "F26"', 'name = "Fixed_Frequency_1", data_set = 3', "Fixed_Frequency_1, data set 3, index 0"),
        ('  { name = "F26"', '  5, { name = "F26"', "parameter 3: is no table"),
        ("parameters = [", "parameters = [[", "no TOML"),
    ],
)
def test_a_damaged_file_is_refused(old: str, new: str, says: str) -> None:
    damaged = TEXT.replace(old, new)
    assert damaged != TEXT
    if "Fixed_Frequency_1" in new:  # the same name twice, in any case of letters
        damaged = damaged.replace("index = 0, ", "")
        says = "Fixed_Frequency_1, data set 3 is there twice"
    with pytest.raises(ConfigError, match=r"^hoist\.toml: ") as caught:
        ParameterList.parse(damaged, "hoist.toml")
    assert says in str(caught.value)
    assert "dump" in str(caught.value)


def test_files_that_cannot_be(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere.toml: No such file"):
        ParameterList.load(tmp_path / "nowhere.toml")
    (tmp_path / "latin.toml").write_bytes(b"\xff")
    with pytest.raises(ConfigError, match="not UTF-8"):
        ParameterList.load(tmp_path / "latin.toml")
    with pytest.raises(UsageError, match="is a directory"):
        LIST.save(tmp_path)
    with pytest.raises(UsageError, match="cannot be written"):
        LIST.save(tmp_path / "no" / "file.toml")


def test_a_device_or_a_pipe_keeps_its_name(tmp_path: Path) -> None:
    """A name in /dev, a pipe: it would have become a file."""
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    (tmp_path / "lead").symlink_to(pipe)
    with pytest.raises(UsageError, match="is a device or a pipe; name an ordinary file"):
        LIST.save(pipe)
    with pytest.raises(UsageError, match="is a link; name the file itself"):
        LIST.save(tmp_path / "lead")
    assert pipe.is_fifo()


def test_a_link_is_not_followed(tmp_path: Path) -> None:
    """Neither for the list nor for the part of one, also where an earlier list stands at its end."""
    kept = tmp_path / "kept.toml"
    LIST.save(kept)
    link, part = tmp_path / "link.toml", tmp_path / "new.toml.part"
    for one in (link, part):
        one.symlink_to(kept)
    for complete in (True, False):
        with pytest.raises(UsageError, match=r"link\.toml: is a link; name the file itself"):
            replace(LIST, complete=complete).save(link)
    with pytest.raises(UsageError, match=r"new\.toml\.part: is a link; name the file itself"):
        replace(LIST, complete=False).save(tmp_path / "new.toml")
    assert {path.name for path in tmp_path.iterdir()} == {"kept.toml", "link.toml", "new.toml.part"}
    assert link.is_symlink()
    assert part.is_symlink()
    assert kept.read_text(encoding="utf-8") == TEXT


def test_the_disk_is_full(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "hoist.toml"
    old = TEXT.replace("address = 3", "address = 4")
    path.write_text(old, encoding="utf-8")

    def full(file: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(
        UsageError, match=r"cannot be written \(No space left on device\); make room there, or name a f"
    ):
        LIST.save(path)
    assert path.read_text(encoding="utf-8") == old
    assert list(tmp_path.iterdir()) == [path]


def test_a_file_is_there_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / "hoist.toml"
    older = TEXT.replace("address = 3", "address = 4")
    path.write_text(older)
    with ParameterList.file(path, *LIST.who):
        assert path.read_text() == older
    assert [one.name for one in tmp_path.iterdir()] == ["hoist.toml"]
    replace(LIST, complete=False).save(path)
    assert path.read_text() == older
    assert ParameterList.load(tmp_path / "hoist.toml.part").complete is False
    LIST.save(path)
    assert path.read_text() == TEXT


@pytest.mark.parametrize("kind", DRIVES)
async def test_each_drive_is_dumped_and_compared(kind: str, tmp_path: Path) -> None:
    count, name, value, data_set = DRIVES[kind]
    path = tmp_path / "it.toml"
    async with in_operate(bus_with(kind, RAW)) as bus:
        it = bus.drive("it")
        seen: list[int] = []
        cycles = bus.stats.slaves[9].exchanges
        found = await it.dump(path, on_parameter=lambda number, of, one: seen.append(number))
        assert ParameterList.load(path) == found
        assert len(found.parameters) == count == len(seen)
        orders = (count - len(found.unreadable)) // it.per_request  # record 47 takes several
        assert bus.stats.slaves[9].exchanges >= cycles + orders  # the bus went on
        same = await it.compare(path, read_only=True)
        assert same.differences == ()
        assert same.same == count - len(found.unreadable)
        await it.write(name, value, data_set=data_set)
        (found_one,) = (await it.compare(found)).differences
        assert found_one.saved.name == name
        assert (found_one.saved.data_set, found_one.found.value) == (data_set, value)
        assert f"drive {value!r}" in found_one.text


async def test_a_parameter_that_cannot_be_read_says_why_and_is_not_compared(tmp_path: Path) -> None:
    async with bus_with("demag-dedrive") as bus:
        await bus.operate()
        it = bus.drive("it")
        found = await it.dump(data_set=2)
        assert {one.data_set for one in found.parameters} == {None, 2}
        texts = [(one.number, one.unreadable) for one in found.unreadable]
        assert texts == [(n, "it is a text, which the parameter channel cannot carry") for n in (281, 284)]
        result = await it.compare(found)
        reasons = {why for one, why in result.skipped if one.data_set in (1, 3, 4)}
        assert reasons == {"it is not in the file"}
        assert {why for one, why in result.skipped if one.number == 270} == {"it is read only"}
        made_up = SavedParam(name="moonlight", number=1, value=3)
        other = await it.compare(replace(found, parameters=(made_up,)), data_set=2)
        assert (made_up, "the plugin does not know it") in other.skipped
        (unit,) = [one for one in found.parameters if one.number == 400]
        (wrong,) = (await it.compare(replace(found, parameters=(replace(unit, unit="Hz"),)))).differences
        assert wrong.text.endswith("file 2 Hz, drive 2 kHz")
        with pytest.raises(UsageError, match=r"demag-dedrive has no data set 7; it has 1..4"):
            await it.dump(data_set=7)
        with pytest.raises(ConfigError, match="the list holds the parameters of a keb-f5"):
            await it.compare(replace(found, drive="keb-f5"))


async def test_a_telegram_without_a_channel_is_refused_at_once(tmp_path: Path) -> None:
    async with bus_of({**slave("demag-dedrive"), "telegram": "PPO3"}) as bus:
        with pytest.raises(UsageError, match="PPO3 of demag-dedrive has no parameter channel"):
            await bus.drive("it").dump(tmp_path / "it.toml")
    assert list(tmp_path.iterdir()) == []


def no_room(file: AtomicFile, octets: bytes) -> None:
    if octets:
        raise UsageError(f"{file.path}: is full")


async def test_cut_short_it_keeps_what_was_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "it.toml"
    path.write_text(older := replace(LIST, drive="demag-dedrive", name="it").text())
    async with bus_with("demag-dedrive") as bus:
        await bus.operate()
        it = bus.drive("it")
        reached = asyncio.Event()

        async def cut_short() -> list[str]:
            reached.clear()
            task = asyncio.ensure_future(it.dump(path, on_parameter=on_parameter))
            await reached.wait()
            task.cancel()
            with pytest.raises(asyncio.CancelledError) as cut:
                await task
            return cut.value.__notes__

        def on_parameter(number: int, count: int, _one: SavedParam) -> None:
            assert count == 44
            if number == 5:
                reached.set()

        assert await cut_short() == [f"cut short: the 5 parameters read so far are in {path}.part"]
        kept = ParameterList.load(tmp_path / "it.toml.part")
        assert (len(kept.parameters), kept.complete) == (5, False)
        # there is no room for them: still what cut it short is what is raised, and nothing is said to be there
        (tmp_path / "it.toml.part").unlink()
        with monkeypatch.context() as patch:
            patch.setattr(AtomicFile, "_write", no_room)
            assert await cut_short() == [f"cut short: the 5 parameters read so far are lost: {path}: is full"]
        assert list(tmp_path.iterdir()) == [path]
        # the drive falls silent: not 39 time-outs, and the reason
        bench_of(bus).power(5, False)
        began = bus.seconds
        with pytest.raises(dpstack.DriveError, match="slave 5"):
            await it.dump(path)
        assert bus.seconds - began < 20
    assert path.read_text() == older


class Mute:
    """A parameter channel that answers S01 with error 17 and the rest with nothing, in octets."""

    def reset(self) -> None:
        return None

    def step(self, octets: bytes) -> bytes:
        return bytes.fromhex("7102 0100 0000 0011") if octets[:4] == bytes.fromhex("1102 0100") else bytes(8)


async def test_a_drive_that_does_not_answer_some() -> None:
    """Reads that are refused stand in the list; a few that time out as well, three in a row end it."""
    async with bus_with("fuji-frenic") as bus:
        await bus.operate()
        it = bus.drive("it")
        device = instance(bench_of(bus).device(5), DriveDevice)
        device.channel = Mute()
        found: list[SavedParam] = []
        with pytest.raises(dpstack.DriveTimeout, match="did not answer"):
            await it.dump(on_parameter=lambda n, of, one: found.append(one))
        assert [one.name for one in found[:2]] == ["S01", "S05"]
        assert str(found[0].unreadable).endswith(": error 17, cannot be read now")
        assert str(found[1].unreadable).endswith(": the drive did not answer in its parameter channel in time")
        assert len(found) == 3


async def _compared(line: str, telegram: str = "PPO1") -> object:
    """The result of comparing a drive with one line of a file."""
    text = TEXT[: TEXT.index("  {")] + line + "\n]\n"
    slaves = [{**slave("demag-dedrive"), "telegram": telegram}]
    async with dpstack.open_bus(port="virtual", baud=500_000, slaves=slaves) as bus:
        await bus.operate()
        return await bus.drive("it").compare(ParameterList.parse(text))


def test_a_file_with_a_value_between_two_steps_is_refused_with_both() -> None:
    line = '  { name = "fixed_frequency_1", number = 480, data_set = 3, value = 5.005, unit = "Hz", title = "x" },'
    says = "480, data set 3|fixed_frequency_1, data set 3: 5.005 Hz lies between two values, the step is 0.01 Hz"
    with pytest.raises(ConfigError, match=says):
        virtual(_compared(line))
    held = instance(virtual(_compared(line.replace("5.005", "5.0"))), ListComparison)
    assert held.same == 1
