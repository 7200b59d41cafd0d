"""The run behind the page: joined, waited for, or started; orders and asks reach it, and no other one; a configuration
file that changes meanwhile."""

from __future__ import annotations

import asyncio
import contextlib
import hashlib
import os
from collections.abc import AsyncIterator, Callable, Sequence
from pathlib import Path
from typing import Any

import msgspec
import plant_files
import pytest
from api_kit import RAW
from far_ends import until

import dpstack
from dpstack.api.bus.bus import core_of
from dpstack.api.config.config import file_digest, load_config
from dpstack.api.control import stream
from dpstack.api.control.client import ControlClient
from dpstack.api.control.commands import KINDS
from dpstack.api.control.control_server import ControlServer, Handler
from dpstack.api.control.handlers import control_run
from dpstack.api.refused_orders import OrdersRefused
from dpstack.plant import items
from dpstack.web import run_source
from dpstack.web.child import Child
from dpstack.web.rights import Rights
from dpstack.web.run_source import RunSource
from dpstack.web.web_server import serve
from tests.web.web_kit import PLANT, WHOLE, Page, delta, event, page_of

TOKEN = "anna-0123456789abcdef"
RIGHTS = Rights(control=True, tokens={TOKEN: "anna"})


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("_LOOK_S", "_SOON_S"):
        monkeypatch.setattr(run_source, name, 0.01)
    monkeypatch.setattr(run_source, "_AGAIN_S", (0.02,))


def plant_file(folder: Path, port: object = "COM7") -> Path:
    return plant_files.plant_file(
        folder, {**RAW, "inputs": {"full": "bool@0.1"}, "outputs": {"lamp": "bool@0.3"}}, port=port
    )


class FakeRun:
    """A run with the configuration ``file`` on COM7: literal items, and the commands that came."""

    def __init__(self, file: Path, **plant: object) -> None:
        self.commands: list[list[str]] = []
        self.over = asyncio.Event()
        self.more: asyncio.Queue[object] = asyncio.Queue()
        self._followers = 0
        self._plant = {"plant": {**PLANT["plant"], **plant}}
        handlers: dict[str, Handler] = {
            "live": lambda _: self._live,
            "operate": lambda _: self.commands.append(["operate"]),
        }
        self.control = ControlServer("run", "COM7", KINDS["run"], handlers, config=file)

    async def _live(self, send: Any) -> None:
        self._followers += 1
        try:
            await send(self._plant)
            await send(WHOLE)
            while (item := await self.more.get()) is not None:
                await send(item)
            self.more.put_nowait(None)  # for other followers
            await send({"end": {"text": "the run was ended"}})
        finally:
            self._followers -= 1

    async def __aenter__(self) -> FakeRun:
        await self.control.__aenter__()
        return self

    async def __aexit__(self, *_: object) -> None:
        self.over.set()
        self.more.put_nowait(None)
        await until(lambda: not self._followers, "its end is told to all who follow it")
        await self.control.__aexit__()


class FakeChild(Child):
    """A child that is no process; ``code`` as given, None: it runs until it is ended."""

    def __init__(self, args: Sequence[str], on_line: Callable[[str], None], code: int | None = None) -> None:
        super().__init__(args, on_line)
        self.args = list(args)
        self._on = on_line
        self._code = code
        self._over = asyncio.Event()

    async def start(self) -> None:
        if self._code is not None:
            self._note("dpstack: COM7 is held by another program")
            self._over.set()

    @property
    def code(self) -> int | None:
        return self._code

    async def wait(self) -> None:
        await self._over.wait()

    async def end(self) -> None:
        self._code = 0
        self._over.set()


class Children:
    """Makes fake children, and knows them."""

    def __init__(self, code: int | None = None) -> None:
        self.made: list[FakeChild] = []
        self.looks = 0  # of the source, for a run
        self._code = code

    def __call__(self, args: Sequence[str], on_line: Callable[[str], None]) -> Child:
        self.made.append(FakeChild(args, on_line, self._code))
        return self.made[-1]


def source_of(file: Path, children: Children, *, control: bool = False) -> RunSource:
    made = RunSource.of(load_config(file), control=control)
    made._make_child = children
    find = made._find

    def counted() -> ControlClient | None:
        children.looks += 1
        return find()

    made._find = counted
    return made


async def told(page: Page, part: str) -> None:
    while part not in (await page.until("event"))["text"]:
        pass


async def test_a_run_is_joined_and_the_next_one_too_and_the_port_is_not_taken_between(tmp_path: Path) -> None:
    file, children = plant_file(tmp_path), Children()
    first = FakeRun(file)
    async with first, serve(source_of(file, children)) as server, page_of(server) as page:
        while (await page.until("welcome"))["source"] != "run":
            pass
        assert (await page.until("snapshot"))["whole"] is True
        await first.__aexit__()
        assert (await page.until("end"))["text"] == "the run was ended"
        assert (await page.until("welcome"))["source"] == "none"
        async with page_of(server) as late:
            assert (await late.until("welcome"))["source"] == "none"
        async with FakeRun(file, read_only=True, port="again"):
            assert (await page.until("welcome"))["source"] == "read-only"
            assert (await page.until("plant"))["port"] == "again"
            assert (await page.until("snapshot"))["whole"] is True
    assert children.made == []


async def test_a_run_that_is_killed_has_ended(tmp_path: Path) -> None:
    file = plant_file(tmp_path)
    run = FakeRun(file)
    async with serve(source_of(file, Children())) as server, page_of(server) as page:
        async with run.control:
            await page.until("snapshot")
        assert (await page.until("end"))["text"] == "the run has ended"
        assert (await page.until("welcome"))["source"] == "none"


async def test_without_a_run_one_that_only_reads_is_started_again_and_again(tmp_path: Path) -> None:
    file, children = plant_file(tmp_path), Children(code=1)
    async with serve(source_of(file, children)) as server, page_of(server) as page:
        await told(page, f"starts dpstack run {file} --read-only")
        await told(page, "has ended with exit code 1: COM7 is held by another program")
        await told(page, f"starts dpstack run {file} --read-only")
        assert "there is no run" in (await page.ask("why", "raw"))["error"]
        assert "--control" in (await page.order("start"))["error"]
    assert {tuple(child.args) for child in children.made} == {("run", str(file), "--read-only", "--json")}


async def test_with_control_nothing_starts_by_itself_and_a_started_run_is_in_clear(tmp_path: Path) -> None:
    file, children = plant_file(tmp_path), Children()
    async with serve(source_of(file, children, control=True), rights=RIGHTS) as server, page_of(server, TOKEN) as page:
        assert (await page.until("welcome"))["source"] == "none"
        await until(lambda: children.looks > 3, "several looks for a run")
        assert children.made == []
        assert "start it first" in (await page.order("operate"))["error"]
        await page.send({"order": {"id": 5, "command": "start", "confirmed": True}})
        await told(page, "starts dpstack run")
        assert [child.args for child in children.made] == [["run", str(file), "--clear", "--json"]]
        async with FakeRun(file) as run:
            assert (await page.until("answer"))["result"]["mode"] == "clear"
            assert (await page.order("start"))["ok"] is False
            assert (await page.order("operate"))["ok"] is True
            assert run.commands == [["operate"]]
            await children.made[0].end()
        await told(page, "has ended")
        looks = children.looks
        await until(lambda: children.looks > looks + 3, "several looks for a run")
        assert len(children.made) == 1


async def test_a_run_that_does_not_come_up_says_why(tmp_path: Path) -> None:
    file, children = plant_file(tmp_path), Children(code=1)
    async with serve(source_of(file, children, control=True), rights=RIGHTS) as server, page_of(server, TOKEN) as page:
        assert (await page.order("start"))["error"] == "start: COM7 is held by another program"


async def test_a_run_that_the_server_started_ends_with_it_and_a_joined_one_goes_on(tmp_path: Path) -> None:
    file, children = plant_file(tmp_path), Children()
    async with serve(source_of(file, children)) as server, page_of(server) as page:
        await told(page, "starts dpstack run")
    assert [child.code for child in children.made] == [0]
    async with FakeRun(file) as run, serve(source_of(file, children)) as server, page_of(server) as page:
        await page.until("snapshot")
        await server.close()
        assert not run.over.is_set()


async def test_another_run_on_the_port_gets_no_order_of_this_page(tmp_path: Path) -> None:
    file = plant_file(tmp_path)
    run = FakeRun(file)
    served = serve(source_of(file, Children()), rights=RIGHTS)
    async with run, served as server, page_of(server, TOKEN) as page:
        await page.until("snapshot")
        about: Any = run.control._help([])
        run.control._handlers["help"] = lambda _: {**about, "pid": os.getpid() + 1}
        assert "another one is there now" in (await page.order("operate"))["error"]
        assert run.commands == []


async def test_a_run_with_another_file_is_told_and_not_joined(tmp_path: Path) -> None:
    file, children = plant_file(tmp_path), Children()
    other = tmp_path / "other.toml"
    async with FakeRun(other), serve(source_of(file, children)) as server, page_of(server) as page:
        await told(page, f"has the configuration {other}, not {file}")
    assert children.made == []


async def test_a_run_that_sends_something_else_than_items_is_told_and_followed(tmp_path: Path) -> None:
    file = plant_file(tmp_path)
    async with FakeRun(file) as run, serve(source_of(file, Children())) as server, page_of(server) as page:
        await page.until("snapshot")
        nonsense: list[object] = [5, [], {"plant": 7}, {"end": 7}]
        for one in nonsense:
            run.more.put_nowait(one)
            await told(page, "no item of the stream")
        foreign: list[object] = [{"note": 5}, {"source": "none"}, {**delta(1, "set_prm"), "note": 5, "source": 5}]
        for one in foreign:
            run.more.put_nowait(one)
        while "snapshot" not in (item := await page.item()):
            assert "welcome" not in item
        assert item == delta(1, "set_prm")


async def test_an_item_of_a_run_is_checked_once_on_its_way_to_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    checked: list[object] = []
    convert = msgspec.convert

    def counted(value: Any, kind: Any) -> Any:
        if kind is items._AnyItem and value.get("event", {}).get("event") != "web":  # those of the server itself
            checked.append(value)
        return convert(value, kind)

    monkeypatch.setattr(msgspec, "convert", counted)
    file = plant_file(tmp_path)
    async with FakeRun(file) as run, serve(source_of(file, Children())) as server, page_of(server) as page:
        await page.until("snapshot")
        sent = [delta(0.2, "set_prm"), event("hello"), {"lost": 3}]
        for one in sent:
            run.more.put_nowait(one)
        assert await page.until("lost") == 3
        assert [next(iter(one)) for one in checked] == ["plant", "snapshot", "snapshot", "event", "lost"]  # type: ignore[call-overload]
        assert checked[1:] == [WHOLE, *sent]


async def test_a_run_that_is_stopped_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream, "TIMEOUT_S", 0.02)
    file = plant_file(tmp_path)
    async with FakeRun(file) as run, serve(source_of(file, Children())) as server, page_of(server) as page:
        await told(page, "is it stopped, or busy?")
        run.more.put_nowait(delta(1, "set_prm"))
        assert (await page.until("snapshot"))["t"] == 1


@contextlib.asynccontextmanager
async def bus_with_page(tmp_path: Path) -> AsyncIterator[tuple[dpstack.Bus, Page, asyncio.Event]]:
    """A bus on "virtual" in this loop, with its control socket, and a page that may give orders."""
    file = plant_file(tmp_path, "virtual")
    stopped = asyncio.Event()
    async with dpstack.open_bus(file) as bus, control_run(bus, "virtual", stop=stopped.set):
        source = RunSource.of(load_config(file), control=True)
        async with serve(source, rights=RIGHTS) as server, page_of(server, TOKEN) as page:
            yield bus, page, stopped


async def test_orders_and_asks_reach_a_bus(tmp_path: Path) -> None:
    async with bus_with_page(tmp_path) as (bus, page, stopped):
        assert (await page.until("plant"))["slaves"]["9"]["name"] == "raw"
        assert bus.mode.name == "CLEAR"
        for order in (("set", "raw.lamp=on"), ("outputs", "9=08")):
            # else they would act when somebody gives operate, whenever that is
            refused = (await page.order(*order))["error"]
            assert refused.startswith("the bus is in Clear, nothing reaches raw: call operate() first")
        assert bus.slave(9).outputs == b"\x00"
        assert (await page.order("operate"))["ok"] is True
        while (await page.until("snapshot"))["bus"].get("mode") != "operate":
            pass
        assert bus.mode.name == "OPERATE"
        assert (await page.order("set", "raw.lamp=on"))["ok"] is True
        assert bus.slave(9).outputs == b"\x08"
        assert (await page.order("force", "raw.full=on"))["ok"] is True
        while bus.slave(9)["full"] is not True:
            await page.until("snapshot")
        assert "no output" in (await page.order("force", "raw.none=on"))["error"]
        assert (await page.order("release", "raw"))["ok"] is True
        while bus.slave(9).inputs != b"\x08":  # the simulated slave mirrors its outputs
            await page.until("snapshot")
        assert (await page.order("outputs", "9=zz"))["ok"] is False
        assert "no slave" in (await page.order("outputs", "77=00"))["error"]
        # the log of the run has those that it has refused, and those that the server has
        assert "not confirmed" in (await page.order("operate", confirmed=False))["error"]
        core_of(bus).refused_orders.report()
        told = [event for event in core_of(bus).past_events() if isinstance(event, OrdersRefused)]
        assert sum(event.count for event in told) == 6
        orders = [order for event in told for order in event.orders]
        assert {order.origin for order in orders} == {"page (anna)"}
        assert [order.order for order in orders][::5] == ["set raw.lamp=on", "operate"]
        assert all(order.reason for order in orders)
        diag = await page.ask("diag", 9)
        assert (diag["result"]["address"], diag["result"]["ident"]) == (9, "0x1234")
        why = await page.ask("why", "raw")
        assert (why["result"]["address"], why["result"]["slave"]) == (9, "raw")
        assert "no slave" in (await page.ask("why", "nobody"))["error"]
        assert (await page.order("stop"))["ok"] is True
        assert stopped.is_set()


async def test_the_web_server_opens_no_port_and_only_this_computer_reaches_it(tmp_path: Path) -> None:
    master, slave = os.openpty()
    try:
        path, children = os.ttyname(slave), Children()
        file = plant_file(tmp_path, path)
        async with serve(source_of(file, children)) as server, page_of(server) as page:
            await told(page, "starts dpstack run")
            held = [os.readlink(f"/proc/self/fd/{fd}") for fd in os.listdir("/proc/self/fd") if _is_link(fd)]
            assert held.count(path) == 1  # that of this test
            assert [one.getsockname()[0] for one in server._sockets] == ["127.0.0.1"]
    finally:
        os.close(master)
        os.close(slave)


def _is_link(fd: str) -> bool:
    return os.path.islink(f"/proc/self/fd/{fd}")


TEXT = '[bus]\nport = "virtual"\nbaud = 500000\n# ümlaut\n'


async def test_the_page_is_told_that_the_file_has_changed_since_the_run_began(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(run_source, "_FILE_S", 0.01)
    file = tmp_path / "plant.toml"
    file.write_text(TEXT, encoding="utf-8")
    digest = hashlib.sha256(file.read_bytes()).hexdigest()
    plant = {"plant": {**PLANT["plant"], "config": str(file), "config_digest": digest}}

    def live(_args: list[str]) -> object:
        async def stream(send: Any) -> None:
            await send(plant)
            await send(WHOLE)
            await asyncio.Event().wait()

        return stream

    async with ControlServer("run", "COM7", KINDS["run"], {"live": live}):
        file.write_text(TEXT + "# changed before the page was opened\n", encoding="utf-8")
        async with serve(RunSource.named("COM7")) as server, page_of(server) as page:

            async def told(part: str) -> None:
                while part not in (await page.until("event"))["text"]:
                    pass

            await told(f"{file} has changed since this run began; the run keeps what it has read")
            file.write_text(TEXT, encoding="utf-8")
            await told("is again as this run has read it")
            file.unlink()
            await told("cannot be read any more")
            async with page_of(server) as late:  # a page that is opened later has the events, too
                while "cannot be read any more" not in (await late.until("event"))["text"]:
                    pass


def test_a_configuration_knows_what_was_read(tmp_path: Path) -> None:
    file = tmp_path / "plant.toml"
    file.write_bytes(b"\xef\xbb\xbf" + TEXT.encode())  # an editor's mark is no change
    config = load_config(file)
    assert config.digest == hashlib.sha256(TEXT.encode()).hexdigest() == file_digest(file)
    file.write_text(TEXT.replace("500000", "187500"), encoding="utf-8")
    assert config.digest != file_digest(file)
    assert config.with_bus(baud=9600).digest == config.digest
    file.write_bytes(b"\xff")
    assert file_digest(file) is None
    assert file_digest(tmp_path) is None
