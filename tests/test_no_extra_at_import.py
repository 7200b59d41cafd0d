"""The first use of the library loads no package of an extra: those that dpstack always needs are enough."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent / "pyproject.toml"
#: msgspec takes it where it is installed
ALSO = {"typing_extensions"}
PROGRAM = """
import sys
before = set(sys.modules)
import dpstack, dpstack.events
dpstack.open_bus(port="virtual", baud=500_000, slaves=[{"name": "io", "address": 9, "ident": 1, "config": "20"}])
new = {name.partition(".")[0] for name in set(sys.modules) - before}
print(*sorted(new - sys.stdlib_module_names))
"""


def normal(distribution: str) -> str:
    return re.sub(r"[-_.]+", "-", distribution).lower()


def test_importing_dpstack_and_the_first_open_bus_load_no_extra() -> None:
    project = tomllib.loads(PROJECT.read_text(encoding="utf-8"))["project"]
    always = {"dpstack", *(normal(re.split(r"[^\w.-]", one)[0]) for one in project["dependencies"])}
    run = subprocess.run([sys.executable, "-c", PROGRAM], capture_output=True, text=True, check=True)
    loaded = set(run.stdout.split())
    assert {"dpstack", "msgspec"} <= loaded
    owners = packages_distributions()
    strange = {
        name: owners.get(name)
        for name in loaded - ALSO - {"dpstack", "dpstack_drives"}
        if not always & {normal(owner) for owner in owners.get(name, [])}
    }
    assert strange == {}
