"""The backlog of the benchmark ``connectors``: values of a real store, several times over, in the order in which they
are read."""

from __future__ import annotations

import tempfile
from pathlib import Path

from history_rig import MB, MEMORY, entry

from bench.plant.backlog import Backlog
from dpstack.bridge.mqtt.history_file import NAME, HistoryFile


def test_the_values_come_several_times_over_and_again() -> None:
    with tempfile.TemporaryDirectory(dir=MEMORY) as name:
        folder = Path(name)
        file = HistoryFile(folder, MB, "a")
        file.append([entry(number) for number in range(3)], 0)
        file.close()
        backlog = Backlog(folder / NAME, 10)
        assert backlog.values == 12
        for _ in range(2):
            backlog.put_back()
            file = HistoryFile(folder, MB, "a")
            kept = file.read(100)
            assert [one.entry.value for one in kept] == [*[0] * 4, *[1] * 4, *[2] * 4]
            file.delete([one.place for one in kept])
            assert file.count == 0
            file.close()
