"""The status codes of docs/reference/opcua.md are those of the reasons."""

from __future__ import annotations

from dpstack.plant.quality import Quality, Reason
from tools import make_opcua_docs


def test_the_page_has_the_status_code_of_each_reason() -> None:
    page = make_opcua_docs.TARGET.read_text(encoding="utf-8")
    assert page == make_opcua_docs.render(page), "run python -m tools.make_opcua_docs"
    for row in (
        "| channel fault | bad | `BadSensorFailure` | 0x808C0000 | Part 8 |",
        "| the slave has no valid data | bad | `BadOutOfService` | 0x808D0000 | Part 8 |",
        "| status octet: sensor conversion not accurate | uncertain | `UncertainSensorNotAccurate` | 0x40930000 "
        "| Part 8; OPC 30142 |",
    ):
        assert f"\n{row}\n" in page
    # the severity of a code, its first two bits, is that of the quality (Part 4, 7.39.1)
    severities = {Quality.GOOD: 0, Quality.UNCERTAIN: 1, Quality.STALE: 1, Quality.BAD: 2}
    assert all(one.opcua_status >> 30 == severities[one.quality] for one in Reason)
