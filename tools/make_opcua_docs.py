"""Writes the table of status codes of docs/reference/opcua.md from dpstack.plant.quality.Reason; a test holds the page
to it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Final

from asyncua.ua import status_codes

from dpstack.plant.quality import Reading, Reason

TARGET: Final = Path(__file__).resolve().parent.parent / "docs" / "reference" / "opcua.md"
_BEGIN: Final = "<!-- table: status codes -->\n"
_END: Final = "<!-- end -->"
#: codes that Part 8 defines for values of automation: 6.3.2 in version 1.04, 7.3.2 in version 1.05
_PART_8: Final = frozenset(
    {
        "BadConfigurationError",
        "BadNotConnected",
        "BadDeviceFailure",
        "BadSensorFailure",
        "BadNoCommunication",
        "BadOutOfService",
        "UncertainNoCommunicationLastUsableValue",
        "UncertainLastUsableValue",
        "UncertainSubstituteValue",
        "UncertainInitialValue",
        "UncertainSensorNotAccurate",
        "UncertainEngineeringUnitsExceeded",
        "UncertainSubNormal",
    }
)


def name_of(code: int) -> str:
    """The name of a status code, as asyncua has it from the list of the OPC Foundation."""
    return str(status_codes.get_name_and_doc(code)[0])


def rows() -> Iterator[str]:
    yield "| reason | quality | status code | number | source |"
    yield "|---|---|---|---|---|"
    without_value = Reading(None, Reason.NOT_EXCHANGING)
    shown = [
        (reason.text or "nothing is against it", reason.quality.value, reason.opcua_status, reason) for reason in Reason
    ]
    shown.append(("a stale one of these, and there never was a value", "bad", without_value.opcua_status, Reason.GOOD))
    for text, quality, code, reason in shown:
        name = name_of(code)
        source = "Part 8" if name in _PART_8 else "Part 4"
        if reason.name.startswith("STATUS_"):
            text, source = f"status octet: {text}", f"{source}; OPC 30142"
        yield f"| {text} | {quality} | `{name}` | 0x{code:08X} | {source} |"


def render(page: str) -> str:
    """``page`` with its table as it is now."""
    before, begin, rest = page.partition(_BEGIN)
    _, end, after = rest.partition(_END)
    return before + begin + "\n".join(rows()) + "\n" + end + after


def main() -> None:
    TARGET.write_text(render(TARGET.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
