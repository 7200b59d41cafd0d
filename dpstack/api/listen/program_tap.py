"""The transmissions of a line that a running program of ours holds, from the tap of its control socket."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncGenerator, Callable
from time import monotonic_ns
from typing import Annotated, TypedDict

import msgspec
from msgspec import Meta

from dpstack.api.control.client import TIMEOUT_S, ControlClient
from dpstack.api.control.errors import failure
from dpstack.api.control.stream import stream_lines
from dpstack.api.listen.tap_cutter import TapCutter
from dpstack.capture.listener import OnTransmission
from dpstack.errors import PortError
from dpstack.trace import Event, Notice, Severity
from dpstack.units import baud_text

#: 64 bits, and room for the sum of two
_TimeNs = Annotated[int, Meta(gt=-(2**62), lt=2**62)]


class _TapItem(TypedDict, total=False):
    """An item of the tap: of the line (``epoch_ns``, ``baud``, ``paced``, ``exact``) or of octets (see
    :meth:`dpstack.api.control.tap_feed.TapFeed.handler`)."""

    epoch_ns: _TimeNs
    baud: int | None
    paced: bool
    exact: bool
    octets: list[tuple[_TimeNs, int, str, bool]]
    lost: Annotated[int, Meta(ge=0, lt=2**62)]


class _TapLine(TypedDict):
    item: _TapItem


class ProgramTap:
    """The tap of the program behind ``client``, which is closed at the end.

    ``on_transmission`` gets each transmission, ``on_event`` what
    :class:`~dpstack.api.listen.tap_cutter.TapCutter` says, and notices.
    """

    def __init__(
        self, client: ControlClient, on_transmission: OnTransmission, on_event: Callable[[Event], None]
    ) -> None:
        self.port = client.port
        #: kind of the program: run, sim or segment
        self.program = ""
        #: rate in bit/s; None while the program searches for it
        self.baud: int | None = None
        #: see :class:`dpstack.api.listen.listening.ListenedLine`
        self.paced = self.exact = False
        self._client = client
        self._on_event = on_event
        self._cutter = TapCutter(client.port, on_transmission, on_event)
        self._items: AsyncGenerator[_TapItem | None] | None = None

    async def open(self) -> None:
        """Ask the program, and read what it says about its line. Raises PortError if it has no tap, or does not
        answer."""
        try:
            about = await asyncio.to_thread(self._client.help)  # it blocks
            self.program = about["kind"]
            if not any(one["command"] == "tap" for one in about["commands"]):
                raise PortError(
                    f"{self.port}: the {self.program} that holds it (pid {about['pid']}) has no tap, as it is another "
                    f"version of dpstack: end it, or start it again with this version"
                )
            self._items = _items(self._client)
            first = await anext(self._items, None)
            if first is None or "epoch_ns" not in first:
                raise PortError(f"{self.port}: the {self.program} that holds it does not begin its tap: is it stopped?")
            self._describe(first)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        items, self._items = self._items, None
        if items is not None:
            await items.aclose()
        self._client.close()

    async def read(self) -> None:
        """Deliver transmissions until the end of the program. Raises PortError then, and for a tap of another kind."""
        assert self._items is not None
        silent = False
        async for item in self._items:
            if item is None:
                if not silent:
                    self._remark(f"the {self.program} has sent nothing for {TIMEOUT_S:g} s: is it stopped, or busy?")
                silent = True
                continue
            if silent:
                self._remark(f"the {self.program} goes on")
                silent = False
            if "epoch_ns" in item:
                self._describe(item)
            if "octets" in item:
                self._read_portion(item)
        self._cutter.give_up()
        raise PortError(f"{self.port}: the program ended")

    def _describe(self, item: _TapItem) -> None:
        before, self.baud = self.baud, item.get("baud")
        if self.baud is None:
            self._remark(f"the {self.program} searches for the baud rate of the bus", Severity.INFO)
        elif before is None and self._cutter.program:
            self._remark(f"the {self.program} has found the bus at {baud_text(self.baud)}", Severity.INFO)
        self._cutter.begin(item["epoch_ns"], self.program)
        self.paced = item.get("paced", False)
        self.exact = item.get("exact", False)

    def _read_portion(self, item: _TapItem) -> None:
        cutter = self._cutter
        try:
            entries = [(end_ns, baud, bytes.fromhex(octets), sent) for end_ns, baud, octets, sent in item["octets"]]
        except ValueError as error:
            raise _strange(self.port, error) from None
        cutter.lose(item.get("lost", 0))
        for entry in entries:
            cutter.add(*entry)
        if not entries:
            cutter.give_up()
        self.baud = cutter.baud or self.baud

    def _remark(self, text: str, severity: Severity = Severity.WARNING) -> None:
        self._on_event(Notice(t_ns=monotonic_ns(), source=self.port, message=text, severity=severity))


async def _items(client: ControlClient) -> AsyncGenerator[_TapItem | None]:
    """The items of the tap until this generator is closed; None as :func:`stream_lines` has it.

    Raises the error of the program, PortError when it ends, or is no dpstack.
    """
    decoder = msgspec.json.Decoder(_TapLine)
    async with contextlib.aclosing(stream_lines(client, "tap")) as lines:
        async for line in lines:
            if line is None:
                yield None
                continue
            try:
                item = decoder.decode(line)["item"]
            except (msgspec.MsgspecError, UnicodeError, RecursionError) as error:
                _refuse(client, line, error)
                return
            yield item


def _refuse(client: ControlClient, line: bytes, error: Exception) -> None:
    """``line`` is no item. Raises the error that it holds, or PortError if it is no line of dpstack; returns if
    it is the end of the tap."""
    answer = client.parsed(line)
    if answer.get("ok") is False:
        raise failure(answer)
    if answer.get("ok") is not True:
        raise _strange(client.port, error)


def _strange(port: str, error: Exception) -> PortError:
    return PortError(f"{port}: its tap is not as dpstack writes it ({error}): is it another version?")
