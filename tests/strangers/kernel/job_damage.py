"""``dpstack run`` with a line that damages answers: 01 00 of slave b arrives as 00 01, a parity error in both octets.

The check sum stays right: only the parity shows this damage. ``job_damage CHIP[@MS]...``: MS is the delay of an error
at the interrupt endpoint.
"""

from __future__ import annotations

import sys

from vm_lab import dpstack, events, plant, plugged, row, slaves

from dpstack.ports.sysfs import Adapter


def main() -> None:
    config = plant()
    with slaves(config) as far:
        for word in sys.argv[1:]:
            chip, _, late = word.partition("@")
            late = late or "0"
            with plugged(chip, options=("--far", far, "--swap", "--late", late)) as adapter:
                words = ("run", config, "--port", adapter.tty, "--seconds", "1", "--json", "--outputs", "9=01000000")
                code, text = dpstack(*words)
                lines, summary = events(text)
                row(
                    "damage",
                    chip=word,
                    driver=Adapter(adapter.tty).driver,
                    damaged=len(adapter.news("damage")),
                    code=code,
                    slave=summary.get("slaves", {}).get("9"),
                    bad=summary.get("bad"),
                    notices=[one["text"] for one in lines if one["event"] == "notice"],
                    states=[one["state"] for one in lines if one["event"] == "slave" and one["address"] == 9],
                    text=text[-6000:],
                )


if __name__ == "__main__":
    main()
