"""RTS and DTR: when a port is opened, in ``capture``, at the end, and after the program was killed.

``job_lines CHIP...``
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys

from vm_lab import Plugged, dpstack, plant, plugged, row, slaves, start, until

#: holds a port as a master does, until it is told to end it or dies
_HOLDER = """
import sys
from dpstack.ports.tty import TtyPort
port = TtyPort(sys.argv[1], 500000)
port.open_now()
print("open", flush=True)
sys.stdin.readline()
port.close()
"""


def hold(path: str) -> subprocess.Popen[str]:
    process = subprocess.Popen(
        [sys.executable, "-c", _HOLDER, path], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    )
    assert process.stdout is not None
    assert process.stdout.readline() == "open\n"
    return process


def lines(adapter: Plugged) -> list[dict[str, int]]:
    return [{name: entry[name] for name in ("dtr", "rts") if name in entry} for entry in adapter.news("lines")]


def state(before: dict[str, int], changes: list[dict[str, int]]) -> dict[str, int]:
    for change in changes:
        before = {**before, **change}
    return before


def main() -> None:
    for chip in sys.argv[1:]:
        with plugged(chip, options=("--echo",)) as adapter:
            adapter.news()
            process = hold(adapter.tty)
            opened = state({}, lines(adapter))
            process.communicate("\n", timeout=20)
            closed = state(opened, lines(adapter))
            process = hold(adapter.tty)
            lines(adapter)
            process.send_signal(signal.SIGKILL)
            process.wait(20)
            killed = state(opened, lines(adapter))
            code, _ = dpstack("capture", "--port", adapter.tty, "--baud", "500000", "--seconds", "0.3")
            captured = lines(adapter)
            adapter.say("count")
            (sent,) = adapter.news("sent")
            row(
                "lines",
                chip=chip,
                opened=opened,
                closed=closed,
                killed=killed,
                capture=captured,
                capture_code=code,
                capture_sent=sent["octets"],
            )
    config = plant()
    with slaves(config) as far, plugged(sys.argv[1], options=("--far", far)) as adapter:
        run = start("run", config, "--port", adapter.tty, "--plain")
        adapter.news()
        assert run.stdout is not None
        for line in run.stdout:
            if line.rstrip().endswith("(c): data_exchange"):
                break
        os.kill(run.pid, signal.SIGKILL)
        run.wait(20)
        until(lambda: False, 0.2)
        row("killed_run", chip=sys.argv[1], lines=state({}, lines(adapter)))


if __name__ == "__main__":
    main()
