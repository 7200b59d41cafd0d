"""A slave of one's own, a tank with a valve, and a master that fills it: both in one simulated bus.

On a real bus the slave is the same; only ``world=world`` becomes ``port="/dev/ttyUSB0", baud=500_000``. For the
engineering tool of a PLC ``dpstack gsd write examples/own_slave.py:TYPE tank.gsd`` writes its GSD file.
"""

import asyncio

import dpstack
from dpstack.slave import DpSlave, SlaveAppState, SlaveDescription, UserDiag, channel_block

NS_PER_S = 1_000_000_000
OVERFLOW = 7  # channel related diagnosis: upper limit exceeded


TYPE = SlaveDescription.simple(0x4711, inputs=2, outputs=1, name="tank")


class Tank:
    """Output octet 0, bit 0: the valve is open. Inputs: the level in 0.1 %, two octets."""

    def __init__(self) -> None:
        self.level = 0.0
        self.valve = False
        self.before = 0

    def cycle(self, outputs: bytes, elapsed: int) -> bytes:
        if self.valve:  # 20 % a second
            self.level = min(100.0, self.level + 20.0 * (elapsed - self.before) / NS_PER_S)
        self.before = elapsed
        self.valve = bool(outputs[0] & 1)  # in Clear, or without a master, these are zeros: the valve closes
        return round(self.level * 10).to_bytes(2, "big")


async def main() -> None:
    tank = Tank()
    slave = DpSlave(TYPE, tank.cycle)
    world = dpstack.World()
    async with (
        dpstack.slave.serve_slave(slave, world=world, address=9) as server,
        dpstack.open_bus(world=world, baud=500_000, slaves=[slave.description.table(9)]) as bus,
    ):
        await bus.operate()
        await server.slave.reached(SlaveAppState.DATA_EXCH, timeout=3)
        bus.slave("tank").outputs = b"\x01"
        await asyncio.sleep(2)
        print(f"level {int.from_bytes(bus.slave('tank').inputs, 'big') / 10:.0f} %")

        slave.diag = UserDiag.of(channel_block(0, 0, OVERFLOW, input=True))  # the master fetches it at once
        await asyncio.sleep(0.1)
        diagnosis = bus.slave("tank").diagnosis
        print(", ".join(diagnosis.flags) if diagnosis else "no diagnosis", diagnosis.ext.hex(" ") if diagnosis else "")
    print("valve open" if tank.valve else "valve closed")  # however serving ends


if __name__ == "__main__":
    asyncio.run(main())
