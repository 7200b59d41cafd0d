"""A run in its bus process, in real time with two processors: ``-icount`` boots one only."""

from __future__ import annotations

from vm_lab import dpstack, events, of_slaves, plant, plugged, row, slaves


def main() -> None:
    config = plant()
    with slaves(config) as far, plugged("ft232r", options=("--far", far)) as adapter:
        words = ("run", config, "--port", adapter.tty, "--seconds", "4", "--driver", "process", "--json")
        code, text = dpstack(*words)
        lines, summary = events(text)
        states, exchanges = (of_slaves(summary, key) for key in ("state", "exchanges"))
        driver = lines[0].get("driver") if lines else None
        row("process", code=code, driver=driver, states=states, exchanges=exchanges, text=text[-3000:])


if __name__ == "__main__":
    main()
