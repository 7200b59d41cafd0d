"""Writes docs/dp-v0.md: every service, option and diagnosis bit of DP-V0 with the tests that show it; a test holds the
file to it and looks whether the tests exist.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final, NamedTuple

from dpstack.dp.diag_bits import FLAGS, Does, Flag

TARGET: Final = Path(__file__).resolve().parent.parent / "docs" / "dp-v0.md"


class End(NamedTuple):
    """One end of a service: the module it is in, and ``file::test`` under ``tests`` that shows it."""

    module: str = ""
    test: str = ""

    @property
    def cells(self) -> str:
        """Two cells of the table."""
        module = f"`{self.module}`" if self.module else ""
        test = f"`{self.test}`" if self.test else ""
        return f"{module} | {test}"


class Row(NamedTuple):
    """A service or an option, and how each end does it."""

    name: str
    what: str
    master: End
    slave: End = End()


_V0 = "dp/test_master_dp_v0.py::"
_M = "dp/test_master.py::"
_OUT = "dp/test_master_ways_out.py::"
_SF = "dp/test_sync_freeze.py::"

SERVICES: Final = (
    Row("Slave_Diag (60)", "first, after Chk_Cfg, and at once after a high-priority answer",
        End("dp/diagnosing.py", _V0 + "test_each_bit_in_data_exchange")),
    Row("Set_Prm (61)", "lock, watchdog, min T_SDR, ident, groups, SYNC and FREEZE asked for, user parameters",
        End("dp/ms0.py", _M + "test_bring_up_to_the_octet")),
    Row("Set_Prm, Unlock", "when a slave is removed, taken out of service, parameterised anew, or ends in a fault",
        End("dp/farewell.py", _M + "test_add_and_remove_while_running")),
    Row("Chk_Cfg (62)", "the identifier octets; a refusal names the octet that differs",
        End("dp/slave_handler.py", _M + "test_refusals_name_the_reason_and_are_retried_with_back_off")),
    Row("Get_Cfg (59)", "after Cfg_Fault, for the message",
        End("dp/slave_handler.py", _V0 + "test_transcript_of_the_bring_up_for_each_bit")),
    Row("Data_Exchange", "in every round from the process image, whether the program calls or not",
        End("dp/master.py", _M + "test_exchange_runs_every_round_whether_the_application_calls_or_not")),
    Row("Global_Control (58)", "Operate and Clear at every change and entry, repeated every 200 ms",
        End("dp/controls.py", _M + "test_global_control_is_really_sent_and_repeated")),
    Row("SYNC, UNSYNC, FREEZE, UNFREEZE", "awaitable orders, each sent once",
        End("dp/controls.py", _SF + "test_each_is_sent_once_to_its_groups")),
    Row("RD_Inp (56), RD_Outp (57), Set_Slave_Add (55)", "services of a class 2 master", End()),
)  # fmt: skip

OPTIONS: Final = (
    Row("lengths", "inputs only, outputs only, neither, up to 244 octets each way, consistent over the whole slave",
        End("dp/master.py", _V0 + "test_data_of_every_length_each_way")),
    Row("a wrong length", "three in a row: safe outputs and Unlock at once, a fault with both lengths",
        End("dp/odd_answers.py", _V0 + "test_a_wrong_length_is_given_up_with_safe_values_at_once")),
    Row("watchdog", "rounded up, 1 ms base where the slave has it (`wd_base_1ms`), the effective time told",
        End("dp/setup.py", _V0 + "test_the_watchdog_is_rounded_up_and_takes_the_1_ms_base_where_it_helps")),
    Row("watchdog against the bus", "the plan warns when the worst case is longer",
        End("dp/plan.py", "dp/test_plan.py::test_a_watchdog_shorter_than_the_worst_case_with_a_dying_slave")),
    Row("Min_Slave_Interval", "shortest time between the beginnings of two rounds",
        End("dp/turns.py", _V0 + "test_min_slave_interval_is_kept_free_running")),
    Row("Fail_Safe", "an empty frame in Clear",
        End("dp/master.py", _M + "test_fail_safe_slave_gets_an_empty_frame_in_clear")),
    Row("auto-clear", "Clear when a slave had no data exchange for `data_control_time_ms`; back by operate() only",
        End("dp/data_control.py", _V0 + "test_auto_clear_after_the_data_control_time_and_back_by_order_only")),
    Row("Operate with auto-clear", "waits in Clear until all slaves are in data exchange",
        End("dp/data_control.py", _V0 + "test_operate_with_auto_clear_waits_for_all_slaves")),
    Row("static diagnosis", "asked again every 100 ms; inputs are not valid, outputs go on",
        End("dp/judge.py", _V0 + "test_stat_diag_is_polled_until_it_is_gone_and_outputs_go_on")),
    Row("extended diagnosis", "device, identifier, channel related, revision; in the words of the GSD file",
        End("dp/diag_texts.py", _V0 + "test_extended_diagnosis_is_told_in_words")),
    Row("lengths that lie in it", "a remark; the rest is kept as it came",
        End("dp/ext_diagnosis.py", _V0 + "test_lengths_that_lie_are_a_finding_and_nothing_more")),
    Row("slaves added and removed", "while the bus runs",
        End("dp/roster.py", _M + "test_add_and_remove_while_running")),
    Row("out of service", "`deactivate()`, `activate()`",
        End("dp/roster.py", _V0 + "test_deactivate_and_activate")),
    Row("parameterised anew", "`reparameterise()`: checked as a whole, then safe outputs, Unlock, bring-up",
        End("dp/roster.py", _V0 + "test_parameterised_anew_while_the_bus_runs")),
    Row("outputs within one telegram", "`group.write()`: outputs, one exchange with each, SYNC",
        End("dp/control_order.py",
            _SF + "test_nobodys_outputs_change_between_syncs_and_all_change_within_one_telegram")),
    Row("inputs of one moment", "`group.read()`: FREEZE, one exchange with each",
        End("dp/control_order.py", _SF + "test_a_picture_is_of_one_moment")),
    Row("back while the group is held", "put back into SYNC alone, before its first outputs, and told",
        End("dp/controls.py",
            _SF + "test_a_slave_that_comes_back_is_put_back_into_its_groups_mode_before_its_outputs")),
    Row("safe values under SYNC", "UNSYNC follows them on every way out",
        End("dp/controls.py", _SF + "test_safe_values_reach_outputs_that_are_held")),
    Row("any order of all that", "ends in data exchange or in the one right fault",
        End("dp/slave_handler.py", "dp/test_master_any_order.py::TestAnyOrder")),
)  # fmt: skip

_HEAD: Final = """# DP-V0

Written by `tools/make_dp_v0_docs.py`; a test holds this page to the program and looks whether the tests named here
exist. Modules are under `dpstack/`, tests under `tests/`.
"""


def render() -> str:
    """The page."""
    columns = "| | | master | shown by | slave | shown by |\n|---|---|---|---|---|---|"
    parts = [_HEAD]
    for title, rows in (("Services", SERVICES), ("Options and what follows from them", OPTIONS)):
        lines = [f"| {row.name} | {row.what} | {row.master.cells} | {row.slave.cells} |" for row in rows]
        parts.append("\n".join([f"## {title}\n", columns, *lines]) + "\n")
    parts.append("\n".join([_BITS, *map(_bit, FLAGS), *_REST]) + "\n")
    return "\n".join(parts)


_BITS: Final = """## The diagnosis, bit by bit

What the master does after Set_Prm and Chk_Cfg (bring-up) and in data exchange; of several bits the weightiest counts.
Bits that a master sets in the diagnosis it keeps for its user are ignored when a slave sets them, and told once.
Each row is shown by `dp/test_master_dp_v0.py::test_transcript_of_the_bring_up_for_each_bit`,
`dp/test_master_dp_v0.py::test_each_bit_in_data_exchange` and `dp/test_master_dp_v0.py::test_the_bits_a_master_sets`.

| octet, bit | name | set by | in the bring-up the master | in data exchange | more | what you read |
|---|---|---|---|---|---|---|"""

_REST: Final = (
    "| 2, 2 | (always 1) | slave | " + f"{Does.TELLS.value} | {Does.TELLS.value} | a slave without it is told once | |",
    "| octet 4 | Master_Add | slave | another master's slave is never parameterised (fault `locked`) | the same | "
    "own + 128, and whoever asks, are tolerated | is owned by master 7 |",
    "| octets 5, 6 | Ident | slave | another device is never parameterised (fault `wrong_ident`) | the same | "
    '`ident = "ask"` takes what is found | is another device: ident 0x1234 instead of 0x0696 |',
)


def _bit(flag: Flag) -> str:
    says = f"{flag.text}; {flag.remedy}" if flag.remedy else flag.text
    bring_up, exchange = (does.value if does else "ignores it" for does in (flag.bring_up, flag.exchange))
    place = f"{flag.octet}, {flag.mask.bit_length() - 1}"
    return f"| {place} | `{flag.name}` | {flag.set_by.value} | {bring_up} | {exchange} | {flag.note} | {says} |"


def main() -> None:
    """Write the page."""
    TARGET.write_text(render(), encoding="utf-8")


if __name__ == "__main__":
    main()
