"""Edge nodes of Sparkplug B, and their ends."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from edge_node_rig import NewRig, Rig


@pytest.fixture
def new_rig(tmp_path: Path) -> Iterator[NewRig]:
    """Makes an edge node that has the plant, with the options of ``Rig``; it is closed at the end of the test."""
    with ExitStack() as ends:

        def make(**options: Any) -> Rig:
            rig = Rig(tmp_path, **options)
            ends.callback(rig.close)
            rig.give_plant()
            return rig

        yield make


@pytest.fixture
def rig(new_rig: NewRig) -> Rig:
    """An edge node in a session, whose births have been sent."""
    made = new_rig()
    made.join()
    return made
