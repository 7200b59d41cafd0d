"""``dpstack doctor`` for a member of dialout before and after the set-up, and what udev makes of the rule."""

from __future__ import annotations

import os
import subprocess
import time
from pathlib import Path

from vm_lab import dpstack, dpstack_json, plugged, row

from dpstack.ports.sysfs import Adapter


def rights(path: str) -> dict[str, object]:
    adapter = Adapter(path)
    timer = os.stat(adapter.latency_file)
    return {"latency_ms": adapter.latency_ms(), "mode": oct(timer.st_mode & 0o777), "group": timer.st_gid}


def of_doctor(path: str) -> dict[str, object]:
    checks = dpstack_json("doctor", "--port", path, as_user=True)["checks"]
    own = [check for check in checks if check["topic"] == path]
    return {
        "findings": [check["text"] for check in own if check["level"] == "finding"],
        "latency": [check["text"] for check in own if "latency timer" in check["text"]],
    }


def main() -> None:
    with plugged("ft232r") as adapter:
        row("before", **rights(adapter.tty), **of_doctor(adapter.tty))
        code, text = dpstack("doctor", "--fix", "--yes")
        subprocess.run(["udevadm", "settle"], check=False)
        time.sleep(0.3)
        row("after_fix", code=code, text=text, **rights(adapter.tty), **of_doctor(adapter.tty))
    rule = Path("/etc/udev/rules.d/99-dpstack.rules")
    with plugged("ft232r") as adapter:
        row("plugged_in", rule=rule.exists(), **rights(adapter.tty), **of_doctor(adapter.tty))


if __name__ == "__main__":
    main()
