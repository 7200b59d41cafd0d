"""The book: long names in the cells of tables."""

from __future__ import annotations

import runpy
from pathlib import Path
from typing import Any

import pytest

import dpstack

#: the configuration of the book imports docutils, which only `make check` needs
pytestmark = pytest.mark.check

_CONF = Path(dpstack.__file__).parents[1] / "docs" / "conf.py"


def test_a_long_name_in_a_cell_breaks_behind_an_underscore_only() -> None:
    break_names = runpy.run_path(str(_CONF))["break_names"]
    name = '<code class="literal"><span class="pre">dpstack_bus_up</span></code>'
    context: dict[str, Any] = {"body": f'<p>{name} a_b</p><td class="x_y"><p>{name} a_b</p></td>'}
    break_names(None, "page", "page.html", context, None)
    broken = name.replace("stack_bus_up", "stack_<wbr>bus_<wbr>up")
    assert context["body"] == f'<p>{name} a_b</p><td class="x_y"><p>{broken} a_b</p></td>'
    empty: dict[str, Any] = {}
    break_names(None, "search", "search.html", empty, None)
    assert empty == {}
