"""Commands on simulated slaves: of a ``sim``, and of a ``run`` whose slaves are simulated in it."""

from __future__ import annotations

from collections.abc import Callable

from dpstack.api.control import arguments
from dpstack.api.control.server import Handler
from dpstack.api.server.virtual_bench import Bench
from dpstack.errors import UsageError
from dpstack.profile.simulator.device import DriveDevice
from dpstack.sim.io_station import IoStation

#: Called after a command: with its name, its arguments, the slave's address and name.
OnOrder = Callable[[str, list[str], int, str], None]


class SlaveCommands:
    """The handlers of :data:`~dpstack.api.control.commands.SLAVES` for ``bench``."""

    def __init__(self, bench: Bench, on_order: OnOrder | None = None) -> None:
        self._bench = bench
        self._on_order = on_order

    def handlers(self) -> dict[str, Handler]:
        return {name: self._reported(name, handler) for name, handler in self._plain().items()}

    def _reported(self, name: str, handler: Handler) -> Handler:
        def command(args: list[str]) -> object:
            result = handler(args)
            if self._on_order is not None:
                address = self._address(args[0])
                self._on_order(name, args, address, self._bench.names()[address])
            return result

        return command

    def _plain(self) -> dict[str, Handler]:
        return {
            "trip": self._drive(lambda drive, code: drive.trip(code)),
            "warn": self._drive(lambda drive, text: drive.warn(arguments.mask(text))),
            "load": self._drive(lambda drive, text: drive.set_load(arguments.number(text, -10, 10, "0.6"))),
            "release": self._drive(lambda drive, text: drive.release(arguments.switch(text))),
            "jog": self._drive(lambda drive, text: drive.jog(arguments.direction(text))),
            "mains": self._drive(lambda drive, text: drive.mains(arguments.switch(text))),
            "link": self._drive(lambda drive, text: drive.link(arguments.switch(text))),
            "parameter-error": self._drive(_refuse),
            "input": self._station(lambda io, slot, args: io.set_input(slot, arguments.hex_octets(args[0], "01"))),
            "wire-break": self._station(
                lambda io, slot, args: io.wire_break(slot, arguments.whole(args[0]), arguments.switch(args[1]))
            ),
            "pull": self._station(lambda io, slot, args: io.pull(slot)),
            "plug": self._station(lambda io, slot, args: io.plug(slot, args[0] if args else "")),
            "parameter": self._station(lambda io, slot, args: io.set_parameter(slot, arguments.octet(args[0]))),
            "silence": self._silence,
            "resume": lambda args: self._bench.resume(self._address(args[0])),
            "power-off": lambda args: self._bench.power(self._address(args[0]), False),
            "power-on": lambda args: self._bench.power(self._address(args[0]), True),
        }

    def _silence(self, args: list[str]) -> None:
        self._bench.silence(self._address(args[0]), arguments.time_ns(args[1]) if len(args) > 1 else None)

    def _drive(self, act: Callable[..., None]) -> Handler:
        """``act`` is called with the drive and the arguments behind its address."""

        def command(args: list[str]) -> None:
            address = self._address(args[0])
            device = self._bench.device(address)
            if not isinstance(device, DriveDevice):
                what = "the I/O station" if isinstance(device, IoStation) else "it mirrors its outputs"
                raise UsageError(f"slave {address} ({device.name}) is no simulated drive: {what}")
            act(device, *args[1:])

        return command

    def _station(self, act: Callable[[IoStation, int, list[str]], str | None]) -> Handler:
        def command(args: list[str]) -> str | None:
            address = self._address(args[0])
            device = self._bench.device(address)
            if not isinstance(device, IoStation):
                raise UsageError(f'slave {address} ({device.name}) is no I/O station; one has gsd = "io-station"')
            left_out = act(device, arguments.whole(args[1]), args[2:])
            return None if left_out is None else f"done, without an alarm: {left_out}"

        return command

    def _address(self, text: str) -> int:
        return address_of(text, self._bench.names())


def _refuse(drive: DriveDevice, error: str, times: str = "1") -> None:
    count = arguments.whole(times)
    if not count:
        raise UsageError("0 times: write 1 or more")
    drive.refuse(error, count)


def address_of(text: str, names: dict[int, str]) -> int:
    """The address of a slave given by address or name. Raises UsageError with the known ones."""
    for address, name in names.items():
        if text in (name, str(address)):
            return address
    known = ", ".join(f"{address} ({name})" for address, name in sorted(names.items())) or "none"
    raise UsageError(f"no slave {text!r} here; there are: {known}")
