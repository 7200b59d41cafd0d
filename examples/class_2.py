"""Look at slaves without being their master's application: diagnosis, configuration, inputs, outputs of any slave."""

import asyncio
from pathlib import Path

import dpstack

PLANT = Path(__file__).with_name("plant.toml")


async def main() -> None:
    async with dpstack.open_bus(PLANT) as bus:
        await bus.ready()
        await bus.operate()
        bus.slave("valves")["flap"] = True  # a named output: only its own bit changes
        await asyncio.sleep(0.1)
        for address in (3, 4, 8):  # any address: the slaves of other masters too, and 126
            diagnosis = await bus.class2.diagnosis(address)
            config = await bus.class2.config(address)
            print(
                f"{address}: ident 0x{diagnosis.ident:04X}, master {diagnosis.master}, config {config.octets.hex(' ')}"
            )
        print("outputs", (await bus.class2.outputs("valves")).values)
        print("inputs", (await bus.class2.inputs("valves")).values)
        try:
            await bus.class2.set_address(126, 20)
        except dpstack.SlaveTimeout as error:
            print(error)


if __name__ == "__main__":
    asyncio.run(main())
