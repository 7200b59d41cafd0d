"""Programs of others that several of these tests need."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from tests.strangers.browser_kit import Browser

if TYPE_CHECKING:
    from tests.strangers.mosquitto_kit import Mosquitto


@pytest.fixture
def broker(tmp_path: Path) -> Iterator[Mosquitto]:
    from tests.strangers.mosquitto_kit import Mosquitto  # needs the extra mqtt

    made = Mosquitto(tmp_path)
    yield made
    made.kill()


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    made = Browser(tmp_path_factory.mktemp("browser"))
    yield made
    made.close()
