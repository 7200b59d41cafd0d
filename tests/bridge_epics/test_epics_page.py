"""The tables of docs/reference/epics.md are those of the nodes and of the reasons."""

from __future__ import annotations

from tools import make_epics_docs


def test_the_page_has_each_process_variable_and_the_alarm_of_each_reason() -> None:
    page = make_epics_docs.TARGET.read_text(encoding="utf-8")
    assert page == make_epics_docs.render(page), "run python -m tools.make_epics_docs"
    for row in (
        "| the slave is not in data exchange | stale | `INVALID` | `COMM` |",
        "| limit exceeded | uncertain | `MINOR` | `HWLIMIT` |",
        "| `SLAVE:drive:state` | state of the drive by the common names of dpstack |",
    ):
        assert f"\n{row}\n" in page
