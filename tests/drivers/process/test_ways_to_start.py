"""The bus process of programs that are started in their own ways: isolated, packed, replaced; and of a full bus."""

from __future__ import annotations

import subprocess
import sys
import zipfile
from pathlib import Path

import pytest
from far_ends import until
from process_kit import SPEC, bus_on, eventually, octet_slaves

import dpstack
import dpstack_drives

PROGRAM = """
import asyncio, os, sys
import dpstack
VALVES = {{"name": "valves", "address": 4, "ident": 0x1234, "config": "21 11"}}
async def main():
    bus = dpstack.open_bus(port={path!r}, baud=1_500_000, slaves=[VALVES], gap=0, driver="process", host_slack_ms=200)
    async with bus:
        await bus.ready()
        await bus.operate()
        bus.slave("valves").outputs = b"\\x11\\x22"
        while bus.slave("valves").inputs != b"\\x11\\x22":
            await asyncio.sleep(0.005)
        {then}
    print(sys.flags.isolated, dpstack.__file__)
if __name__ == "__main__":
    asyncio.run(main())
"""


def run(*command: str) -> list[str]:
    """The words that a program prints."""
    return subprocess.run(
        [sys.executable, *command], capture_output=True, text=True, timeout=100, check=True
    ).stdout.split()


@pytest.mark.soak
def test_an_isolated_interpreter(tmp_path: Path) -> None:
    """``python -I``: nothing of the environment counts, and the bus process finds everything all the same."""
    with octet_slaves(SPEC) as (path, there):
        (tmp_path / "plant.py").write_text(PROGRAM.format(path=path, then=""))
        assert run("-I", str(tmp_path / "plant.py"))[0] == "1"
        eventually(lambda: there.slaves[4].outputs == bytes(2), "its last octets read")


@pytest.mark.soak
def test_a_zipapp(tmp_path: Path) -> None:
    """``python -m zipapp``: dpstack is in the archive, what is compiled beside it."""
    packed = tmp_path / "plant.pyz"
    with octet_slaves(SPEC) as (path, there):
        with zipfile.ZipFile(packed, "w") as archive:
            for package in (dpstack, dpstack_drives):
                assert package.__file__ is not None
                root = Path(package.__file__).parent
                for file in [*root.rglob("*.py"), *root.rglob("*.gsd")]:
                    archive.write(file, file.relative_to(root.parent))
            archive.writestr("__main__.py", PROGRAM.format(path=path, then=""))
        assert run(str(packed))[1].startswith(str(packed))
        eventually(lambda: there.slaves[4].outputs == bytes(2), "its last octets read")


@pytest.mark.soak
def test_a_program_that_another_one_takes_the_place_of(tmp_path: Path) -> None:
    """``exec``: the bus process notices it, ends in order, and the next one has the port."""
    with octet_slaves(SPEC) as (path, there):
        again = "if len(sys.argv) == 1: os.execv(sys.executable, [sys.executable, *sys.argv, 'again'])"
        (tmp_path / "plant.py").write_text(PROGRAM.format(path=path, then=again))
        assert run(str(tmp_path / "plant.py"))[0] == "0"
        eventually(lambda: there.slaves[4].outputs == bytes(2), "its last octets read")


@pytest.mark.soak
async def test_a_hundred_slaves() -> None:
    addresses = range(3, 103)
    slaves: list[dict[str, object]] = [
        {"name": f"s{address}", "address": address, "ident": 0x1234, "config": "20 10"} for address in addresses
    ]
    with octet_slaves(*(f"{address}:1234:2010:1:1" for address in addresses)) as (path, there):
        async with bus_on(path, "process", *slaves, host_slack_ms=200) as bus:
            await bus.ready(100)
            await bus.operate()
            for slave in bus.slaves:
                slave.outputs = bytes((slave.address,))
            await until(lambda: all(slave.inputs == bytes((slave.address,)) for slave in bus.slaves), "all mirrors")
        await until(lambda: all(slave.outputs == bytes(1) for slave in there.slaves.values()), "Clear")
