"""The order in which ``make test`` gives files to its processes: the longest first, so that none of them is left for
the end, when the other processes have nothing to do."""

from __future__ import annotations

from functools import cached_property
from typing import Final

from xdist.scheduler import LoadFileScheduling
from xdist.workermanage import WorkerController

#: files of more than 5 s, the longest first; those that wait for programs among those that compute
LONG_FILES: Final = (
    "tests/cli/commands/test_processes.py",
    "tests/test_docs.py",
    "tests/bridge_opcua/test_opcua_connector.py",
    "tests/drivers/process/test_silent_process.py",
    "tests/drivers/line/test_held_up_driver.py",
    "tests/api/bus/test_both_drivers.py",
    "tests/cli/commands/test_drive.py",
    "tests/test_bench_wire.py",
    "tests/test_fault_matrix.py",
    "tests/test_benchmarks.py",
    "tests/cli/commands/test_commands.py",
    "tests/cli/terminal/test_standard_streams.py",
    "tests/fdl/active/test_active_gap.py",
    "tests/drivers/process/test_starts.py",
    "tests/cli/commands/test_on_a_segment.py",
    "tests/sim/test_adapter.py",
    "tests/cli/commands/test_ctl.py",
    "tests/api/bus/test_every_way_out.py",
    "tests/ports/test_contract.py",
    "tests/drivers/process/test_process_ends.py",
    "tests/cli/test_malformed_answers.py",
    "tests/cli/commands/test_run_parts.py",
    "tests/api/slave/test_killed_among_services.py",
    "tests/decode/test_names.py",
    "tests/fdl/active/test_ring_leaving.py",
    "tests/drivers/process/test_messages.py",
    "tests/test_uart_level.py",
    "tests/dp/master/test_cycle_on_ports.py",
    "tests/plant/test_tree_rules.py",
    "tests/cli/looking/test_pa_command.py",
    "tests/api/slave/test_drives_on_a_bus.py",
    "tests/drives/test_drive_pairs.py",
    "tests/cli/commands/test_scan.py",
    "tests/cli/commands/test_troubled_run.py",
)


class LongFilesFirst(LoadFileScheduling):  # type: ignore[misc]  # xdist has no types
    """``--dist loadfile`` with :data:`LONG_FILES` first, then the files with most tests.

    The class of xdist counts all tests of a process after each of them, and looks for each in the list of all: 6 s of a
    processor with 20 000 tests. This one keeps the tests that are still to come, and where each is in the list.
    """

    @cached_property
    def _index(self) -> dict[str, int]:
        """By test: its place in the list of all, which is the same in each process (xdist checks that)."""
        assert self.collection is not None
        return {nodeid: index for index, nodeid in enumerate(self.collection)}

    @cached_property
    def _long(self) -> list[str]:
        """The long files that have not begun, the longest last."""
        return [name for name in reversed(LONG_FILES) if name in self.workqueue]

    def _assign_work_unit(self, node: WorkerController) -> None:
        if self._long:
            self.workqueue.move_to_end(self._long.pop(), last=False)
        scope, unit = self.workqueue.popitem(last=False)
        self.assigned_work[node][scope] = unit
        node.send_runtest_some([self._index[nodeid] for nodeid in unit])

    def mark_test_complete(self, node: WorkerController, item_index: int, duration: float = 0) -> None:
        nodeid = self.registered_collections[node][item_index]
        units, scope = self.assigned_work[node], self._split_scope(nodeid)
        del units[scope][nodeid]
        if not units[scope]:
            del units[scope]
        self._reschedule(node)

    def _pending_of(self, workload: dict[str, dict[str, bool]]) -> int:
        return sum(map(len, workload.values()))
