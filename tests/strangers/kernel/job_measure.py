"""``dpstack doctor --measure`` with an echo, and with a second adapter at the other end of the line."""

from __future__ import annotations

from vm_lab import dpstack, plugged, row

from dpstack.api.measure import measure

_RATES = (187_500,)


def main() -> None:
    with plugged("ft232r", options=("--echo",)) as adapter:
        row("echo", found=measure(adapter.tty, "", rounds=100, rates=_RATES))
        adapter.say("count")
        before = adapter.news("sent")[-1]["octets"]
        refused = dpstack("doctor", "--measure", "--port", adapter.tty, "--loop")
        passive = dpstack("doctor", "--measure", "--port", adapter.tty, "--json")
        adapter.say("count")
        after = adapter.news("sent")[-1]["octets"]
        row("unasked", refused=refused, passive=passive, sent=after - before)
    for near in ("ft232r", "cp2102n", "cp2102clone", "ch340"):
        with plugged(near, "ft232h") as line:
            second = next(tty for tty in line.ttys if tty != line.tty)
            rates = (500_000,) if near == "cp2102clone" else _RATES
            row("second", chip=near, found=measure(line.tty, second, rounds=30, rates=rates))


if __name__ == "__main__":
    main()
