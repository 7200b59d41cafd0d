"""A script without asyncio, from the top to the bottom: a flap opens, a simulated fan starts.

On a real line leave ``port="virtual"`` out; the bus then runs in a process of its own. The same lines work one by one
in a Python shell and in Jupyter (docs/how-to/blocking.md).
"""

from pathlib import Path

import dpstack
from dpstack import blocking

PLANT = Path(__file__).with_name("plant.toml")


def fan_up(fan: blocking.Drive) -> None:
    fan.speed = 0.1
    fan.start()
    for status in fan.statuses(timeout=10):
        if status.reached:
            print(f"the fan is at {status.speed:.0%}")
            return


with blocking.open_bus(PLANT, port="virtual") as bus:
    bus.ready()
    bus.operate()
    valves = bus.slave("valves")
    valves["flap"] = True
    valves.until(lambda inputs: inputs["limit"] is True, timeout=5)
    print("the flap is open")
    try:
        fan_up(bus.drive("fan"))
    except (dpstack.DriveError, TimeoutError) as error:
        print(error)
