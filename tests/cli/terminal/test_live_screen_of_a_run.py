"""Orders of the watch table of the live screen, carried out by ``run``: accounted for, refused with the reason."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

from api_kit import RAW, bus_of, virtual

from dpstack.cli.terminal.live_screen import LiveScreen

NAMED = RAW | {"inputs": {"level": "u8@0"}, "outputs": {"lamp": "bool@0.3"}}


def test_orders_of_the_person_at_the_screen() -> None:
    async def program() -> None:
        events: list[str] = []
        bus = bus_of(NAMED, on_event=lambda event: events.append(event.text))
        answers: asyncio.Queue[tuple[str, str]] = asyncio.Queue()
        screen = LiveScreen(cast(Any, None), bus, cast(Any, None), cast(Any, None), lambda: "virtual")
        screen._process = cast(
            Any, SimpleNamespace(tell=lambda message: answers.put_nowait(tuple(message["answer"].values())))
        )

        async def order(**order: object) -> tuple[str, str]:
            screen._take(order)
            return await answers.get()

        async with bus:
            await bus.ready()
            text, severity = await order(order="set", text="9.lamp=on")
            assert severity == "warning"  # an output that waits would act at any time later
            assert text.startswith("set 9.lamp=on: refused: ")
            assert bus.slave(9).outputs == b"\x00"
            await bus.operate()
            assert await order(order="set", text="9.lamp=on") == ("set 9.lamp=on: done", "info")
            assert bus.slave(9).outputs == b"\x08"
            assert await order(order="set", text="9.level=7") == ("set 9.level=7: done", "info")
            await bus.rotated(bus.stats.rotations + 3)
            assert bus.slave(9).inputs == b"\x07"
            assert await order(order="release", slave=9) == ("mirror 9: done", "info")
            await bus.rotated(bus.stats.rotations + 3)
            assert bus.slave(9).inputs == b"\x08"
            for text in ("9.lamp=maybe", "9.none=1", "77.lamp=on", "nonsense"):
                assert (await order(order="set", text=text))[1] == "warning"
            await asyncio.sleep(2)
        told = "\n".join(events)
        assert "order set 9.lamp=on" in told
        assert "screen: order set 9.lamp=on refused" in told
        assert "screen: order set 77.lamp=on refused" in told or "more" in told

    virtual(program())
