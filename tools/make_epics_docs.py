"""Writes the tables of docs/reference/epics.md: process variables from dpstack.plant.nodes, alarms from
dpstack.bridge.epics.alarms; a test holds the page to them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from dpstack.bridge.epics.alarms import of_reason
from dpstack.bridge.epics.names import pvs_of
from dpstack.plant.items import DrivePlant, FieldPlant, PlanPlant, Plant, SlavePlant
from dpstack.plant.nodes import Kind, bus_of, slave_of
from dpstack.plant.quality import Reason

TARGET: Final = Path(__file__).resolve().parent.parent / "docs" / "reference" / "epics.md"
_END: Final = "<!-- end -->"
_TEXTS: Final = {
    "SLAVE:in:NAME": "a named input",
    "SLAVE:out:NAME": "a named output: what the slave gets",
    "SLAVE:cmd:start": "a drive's order that `allow_commands` lists; also `stop`, `quick_stop`, `coast`, `acknowledge`",
    "SLAVE:cmd:speed": "the set point of a drive, if `allow_commands` lists it",
}


def variables() -> Iterator[str]:
    """Names with their texts; statistics in one line a branch."""
    drive = slave_of(9, SlavePlant(name="SLAVE", dpv1=True, drive=DrivePlant()), writable=True)
    inputs, outputs = [FieldPlant(name="NAME", at="u8@0")], [FieldPlant(name="NAME", at="u8@0")]
    plants = (SlavePlant(name="SLAVE", inputs=inputs), SlavePlant(name="SLAVE", outputs=outputs))
    values = [slave_of(9, one, writable=True) for one in plants]
    bus = bus_of(Plant(plan=PlanPlant(cycle_us=1), slaves={})).nodes
    shown: dict[str, str] = {}
    statistics: dict[str, list[str]] = {}
    for one in (drive, *values):
        for name, pv in pvs_of("", bus, {9: one}, lambda _: True).pvs.items():
            if pv.node.kind is Kind.STATISTIC:
                branch, _, word = name.partition(":stat:")
                words = statistics.setdefault(branch, [])
                if word not in words:
                    words.append(word)
            elif ":cmd:" not in name or name in _TEXTS:
                shown.setdefault(name, _TEXTS.get(name) or pv.node.text or pv.node.path[-1])
    yield "| name behind the prefix | content |"
    yield "|---|---|"
    for name, text in sorted(shown.items(), key=lambda pair: pair[0].count(":")):
        yield f"| `{name}` | {text} |"
    for branch, words in statistics.items():
        yield f"| `{branch}:stat:...` | counters and times: {', '.join(f'`{word}`' for word in words)} |"


def alarms() -> Iterator[str]:
    yield "| reason | quality | severity | status |"
    yield "|---|---|---|---|"
    for reason in Reason:
        alarm = of_reason(reason)
        text = f"status octet: {reason.text}" if reason.name.startswith("STATUS_") else reason.text
        severity = alarm.severity.name.removesuffix("_ALARM") if alarm.severity else "NO_ALARM"
        yield f"| {text or 'nothing is against it'} | {reason.quality.value} | `{severity}` | `{alarm.status.name}` |"


def render(page: str) -> str:
    """``page`` with its tables as they are now."""
    for title, rows in (("process variables", variables()), ("alarms", alarms())):
        before, begin, rest = page.partition(f"<!-- table: {title} -->\n")
        _, end, after = rest.partition(_END)
        page = before + begin + "\n".join(rows) + "\n" + end + after
    return page


def main() -> None:
    TARGET.write_text(render(TARGET.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
