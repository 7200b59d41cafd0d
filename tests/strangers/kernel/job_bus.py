"""Runs over the kernel's drivers: the cost of a latency timer, long telegrams, scan, baud, monitor."""

from __future__ import annotations

import sys
import time

from vm_lab import SLAVES, dpstack, events, of_slaves, plant, plugged, row, slaves, start


def run(chip: str, config: str, far: str, baud: int, *options: str, name: str, outputs: str = "") -> None:
    with plugged(chip, options=("--far", far, *options)) as adapter:
        words = ["run", config, "--port", adapter.tty, "--baud", str(baud), "--seconds", "1", "--json"]
        code, text = dpstack(*words, *(("--outputs", outputs) if outputs else ()))
        _, summary = events(text)
        row(
            "run",
            name=name,
            chip=chip,
            baud=baud,
            code=code,
            rotation_us=summary.get("rotation_us"),
            host_us=summary.get("host_us"),
            retries=sum(of_slaves(summary, "retries").values()),
            timeouts=sum(of_slaves(summary, "timeouts").values()),
            inputs=of_slaves(summary, "inputs"),
            exchanges=of_slaves(summary, "exchanges"),
            latency_ms=[one["ms"] for one in adapter.news("latency")],
        )


def main() -> None:
    config = plant()
    with slaves(config) as far:
        run("ft232r", config, far, 187_500, name="1 ms")
        run("ft232r", config, far, 187_500, "--stuck", "16", name="16 ms")
        event = plant(event_char=True)
        run("ft232r", event, far, 187_500, "--stuck", "16", name="16 ms, event character")
        for chip in sys.argv[1:]:
            run(chip, config, far, 187_500, name=chip)
        with plugged("ft232r", options=("--far", far)) as adapter:
            code, text = dpstack("scan", "--port", adapter.tty, "--baud", "187500", "--json")
            row("scan", code=code, text=text)
    long = plant({**SLAVES[0], "config": "5F 5F 5F 5F 5F 5F 6F 6F 6F 6F 6F 6F"}, *SLAVES[1:])
    with slaves(long, 500_000) as far:
        octets = bytes(range(192)).hex()
        run("ft232r", long, far, 500_000, name="long", outputs=f"8={octets}")
        run("cp2102n", long, far, 500_000, name="long", outputs=f"8={octets}")
    heard()


def heard() -> None:
    """A bus of two adapters on one line: a run through one, baud and monitor listen at the other."""
    alone = plant(SLAVES[2])
    with plugged("ft232r", "cp2102n") as line:
        first, second = line.ttys
        run = start("run", alone, "--port", first, "--baud", "187500", "--seconds", "20", "--plain")
        time.sleep(2.5)
        code, text = dpstack("baud", "--port", second, "--json")
        row("baud", code=code, text=text)
        code, text = dpstack("monitor", "--port", second, "--baud", "187500", "--seconds", "1", "--json")
        row("monitor", code=code, text=text.splitlines()[-1])
        run.terminate()
        run.communicate(timeout=60)


if __name__ == "__main__":
    main()
