"""Programs of others that several of these tests need."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from tests.strangers.mosquitto_kit import Mosquitto


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    from tests.strangers.mosquitto_kit import Mosquitto  # needs the extra mqtt

    made = Mosquitto(tmp_path)
    yield made
    made.kill()
