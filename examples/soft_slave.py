"""A slave made of software for a PLC: a mixer that is served in the cycle, reports its diagnosis, and has a GSD file.

Start it with ``python examples/soft_slave.py`` beside a simulated PLC, which reads the GSD file as an engineering tool
does, or with ``python examples/soft_slave.py /dev/ttyUSB0`` for a real PLC until Ctrl-C: import mixer.gsd there first.
"""

import asyncio
import contextlib
import sys
import tempfile
from pathlib import Path

import dpstack
from dpstack.events import SlaveDiagnosis
from dpstack.gsd import DiagText
from dpstack.slave import (
    AddressChanged,
    AlarmAcknowledged,
    BaudStateChanged,
    ClockJumped,
    ClockLost,
    ClockSet,
    ConnectionClosed,
    ConnectionOpened,
    DeviceFailed,
    DpSlave,
    LinkChanged,
    PortBaudChanged,
    RequestRefused,
    SlaveAppEvent,
    SlaveAppState,
    SlaveAppStateChanged,
    SlaveDescription,
    UserDiag,
    WatchdogExpired,
    channel_block,
    gsd_octets,
)

BAUD, ADDRESS = 500_000, 9
TOO_HOT = 17  # the first error of a channel that the manufacturer defines
TYPE = SlaveDescription(
    ident=0x4711,
    name="mixer",
    vendor="Nobody & Sons",
    configs=(bytes.fromhex("11 20"),),  # two octets of inputs, one of outputs
    diag_texts=(DiagText("channel", None, None, TOO_HOT, "mixer too hot", "let it cool down"),),
)


class Mixer:
    """Output bit 0: the motor. Input octet 0: the motor runs; input octet 1: its temperature in degrees C."""

    def __init__(self) -> None:
        self.slave = DpSlave(TYPE, self.cycle)
        self.on = False
        self.temperature = 20.0

    def cycle(self, outputs: bytes, elapsed: int) -> bytes:
        """Called at each Data_Exchange, and with zeros as soon as the outputs are no longer valid: never wait here."""
        self.on = bool(outputs[0] & 1)
        return bytes((self.on, round(self.temperature)))

    async def run(self) -> None:
        """The process, beside the bus: the motor warms up by 20 degrees a second, and the diagnosis follows."""
        hot = False
        while True:
            await asyncio.sleep(0.1)
            self.temperature = min(90.0, self.temperature + 2) if self.on else max(20.0, self.temperature - 2)
            if hot != (self.temperature > 60):
                hot = not hot
                block = channel_block(0, 0, TOO_HOT, input=True)
                self.slave.diag = UserDiag.of(block) if hot else UserDiag()


def tell(event: dpstack.Event) -> None:
    """A case for every event of a served slave; this one has no alarms, and neither searches a rate nor class 2."""
    match event:
        case SlaveAppStateChanged(state=SlaveAppState.DATA_EXCH, master=master):
            print(f"mixer: in data exchange with master {master}")
        case WatchdogExpired():
            print("mixer: the PLC is silent, the motor is off")
        case RequestRefused(service=service, master=master, reason=reason):
            print(f"mixer: {service} of master {master} does not fit: {reason}")
        case DeviceFailed(error=error, origin=origin):
            print(f"mixer: repair the program: {error} {origin}")
        case LinkChanged(publisher=publisher, good=False, reason=reason):
            print(f"mixer: its octets of publisher {publisher} are safe now: {reason}")
        case ClockSet(master=master) | ClockLost(master=master) | ClockJumped(master=master):
            print(f"mixer: time of master {master}: {event.text}")
        case AddressChanged(address=address, master=master):
            print(f"mixer: master {master} gave it the address {address}")
        case AlarmAcknowledged(alarm=alarm):
            print(f"mixer: the PLC has seen the {alarm.text}")
        case BaudStateChanged(baud=baud) | PortBaudChanged(baud=baud):
            print(f"mixer: {'looks for the rate' if baud is None else f'the bus runs at {baud} bit/s'}")
        case ConnectionOpened(master=master) | ConnectionClosed(master=master):
            print(f"mixer: {event.text}")
        case SlaveAppEvent():
            pass  # the other states: event.text has them in words


def write_gsd(path: Path) -> None:
    """The same as ``dpstack gsd write examples/soft_slave.py:TYPE mixer.gsd``."""
    path.write_bytes(gsd_octets(TYPE))


async def simulated_plc(world: dpstack.World, gsd: Path) -> None:
    """Configured by the GSD file; switches the motor on until the mixer is too hot."""
    table: dict[str, object] = {"name": "mixer", "address": ADDRESS, "gsd": str(gsd)}
    async with dpstack.open_bus(world=world, baud=BAUD, slaves=[table]) as bus:
        await bus.operate()
        await bus.ready()
        mixer = bus.slave("mixer")
        mixer.outputs = b"\x01"
        async for event in bus.events():
            match event:
                case SlaveDiagnosis(texts=texts) if any("too hot" in text for text in texts):
                    print("PLC:", *texts)
                    print("PLC: inputs", mixer.inputs.hex(" "))
                    mixer.outputs = b"\x00"
                case SlaveDiagnosis() if mixer.outputs == b"\x00":
                    print("PLC: no diagnosis any more")
                    break


async def main(port: str) -> None:
    mixer = Mixer()
    process = asyncio.create_task(mixer.run())
    try:
        if port == "virtual":
            world = dpstack.World()
            with tempfile.TemporaryDirectory() as folder:
                gsd = Path(folder, "mixer.gsd")
                write_gsd(gsd)
                async with dpstack.slave.serve_slave(mixer.slave, world=world, address=ADDRESS, on_event=tell):
                    await simulated_plc(world, gsd)
            print("mixer:", "on" if mixer.on else "off")
        else:
            write_gsd(Path("mixer.gsd"))
            async with dpstack.slave.serve_slave(
                mixer.slave, port=port, baud=BAUD, address=ADDRESS, on_event=tell
            ) as server:
                print(f"mixer: serving at {server.port_name}, described by mixer.gsd")
                await server.serve_forever()
    finally:
        process.cancel()


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C: the outputs have become zeros
        asyncio.run(main(sys.argv[1] if len(sys.argv) > 1 else "virtual"))
