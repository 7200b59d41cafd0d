"""A logger: process data of every round in Parquet files, a new one when a file is full, then read back by pyarrow.

Start it with ``python examples/parquet_logger.py`` for 20 seconds of a simulated tank, or with
``python examples/parquet_logger.py /dev/ttyUSB0 FOLDER`` on a real bus until Ctrl-C; the files are in FOLDER.
"""

import asyncio
import contextlib
import sys
import tempfile
from pathlib import Path

import dpstack

try:
    import pyarrow
    import pyarrow.parquet
except ImportError:
    raise SystemExit("this example needs pyarrow: pip install 'dpstack[parquet]'") from None

BAUD = 500_000
TANK: dict[str, object] = {
    "name": "tank",
    "address": 9,
    "ident": 0x1234,
    "config": "21 11",  # the simulated one gives back the outputs as its inputs
    "inputs": {"level": {"at": "i16@0", "scale": 0.1, "unit": "%", "dead_band": 0.2}},
    "outputs": {"valve": {"at": "i16@0", "scale": 0.1, "unit": "%"}},
}


async def fill(tank: dpstack.Slave) -> None:
    """1 % more in every 0.1 s, again and again from 0 %."""
    while True:
        for percent in range(101):
            tank["valve"] = percent
            await asyncio.sleep(0.1)


async def keep(port: str, folder: Path) -> tuple[Path, ...]:
    """Record for 20 s, on a real bus until it is cancelled. Returns the files."""
    async with dpstack.open_bus(port=port, baud=BAUD, slaves=[TANK]) as bus:
        # a day on a real bus: rotate="1h". on_change keeps a row only when a value leaves its dead band
        recording = bus.record(folder / "tank.parquet", on_change=True, rotate="10kB")
        await bus.operate()
        await bus.ready(20)
        filling = asyncio.create_task(fill(bus.slave("tank")))
        try:
            await asyncio.wait([filling], timeout=20 if port == "virtual" else None)
        finally:
            filling.cancel()
            await recording.stop()  # the last file becomes Parquet now
            print(f"{recording.rows} rows, {recording.lost} lost", *recording.troubles, sep="\n  ")
    return tuple(recording.paths)


def read_back(folder: Path) -> None:
    """Any tool that reads Parquet does it: pandas.read_parquet(folder), duckdb, Spark."""
    files = sorted(folder.glob("tank_*.parquet"))
    table = pyarrow.concat_tables([pyarrow.parquet.read_table(file) for file in files])
    levels = table["tank.level"].drop_null().to_pylist()
    print(f"{len(files)} files, {table.num_rows} rows, level {min(levels):.0f} to {max(levels):.0f} %")


def main(port: str, folder: Path) -> None:
    with contextlib.suppress(KeyboardInterrupt):  # Ctrl-C: the bus has ended in order
        asyncio.run(keep(port, folder))
    read_back(folder)


if __name__ == "__main__":
    if len(sys.argv) > 2:
        main(sys.argv[1], Path(sys.argv[2]))
    else:
        with tempfile.TemporaryDirectory() as temporary:
            main(sys.argv[1] if len(sys.argv) > 1 else "virtual", Path(temporary))
