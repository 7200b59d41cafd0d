"""Over the kernel's own drivers: a pulled plug, other programs at the port of a run, a port that others hold."""

from __future__ import annotations

import pytest
from vm_machine import Result, boot

pytestmark = [pytest.mark.strangers, pytest.mark.kernel]


@pytest.fixture(scope="module")
def result() -> Result:
    return boot("job_life")


def test_a_pulled_plug_is_called_so_and_the_adapter_is_found_under_its_new_name(result: Result) -> None:
    (row,) = result.of("unplugged")
    assert row["after"] != row["before"]
    assert "vanished (the adapter is gone: its plug was pulled, or it lost its power)" in row["text"]
    assert "hung up" not in row["text"]
    assert row["text"].count("slave 8 (a): data_exchange") == 2


def test_settings_of_another_program_are_set_again_and_reported(result: Result) -> None:
    (row,) = result.of("stty")
    assert row["stty"] == 0
    assert row["rates"] == [9600.0, 187_500.0]
    assert "another program has set it to 9.6 kbit/s, another frame than 8E1; it is set to 187.5 kbit/s" in row["text"]
    assert row["code"] == 0
    assert row["text"].count("): data_exchange") > 3  # those that were lost are back


def test_a_second_reader_is_kept_out_or_named(result: Result) -> None:
    (row,) = result.of("reader")
    assert "busy" in row["user"]  # one of a user: TIOCEXCL
    assert "cat (pid" in row["text"]
    assert "has it open, too, and takes octets away: end that program" in row["text"]
    assert row["text"].count("1. another_program (88 %)") == 3  # the summary tells why, for each slave
    assert "raise t_sl" not in row["text"]
    assert "takes octets away from `dpstack run " in row["doctor"]


def test_a_holder_that_opens_adapters_by_itself_is_named_with_its_udev_line(result: Result) -> None:
    (row,) = result.of("held")
    assert "is held by ModemManager (pid" in row["doctor"]
    assert 'ATTRS{idVendor}=="0403", ATTRS{idProduct}=="6001", ENV{ID_MM_PORT_IGNORE}="1"' in row["doctor"]
    assert "dpstack ctl" not in row["doctor"]


def test_space_parity_of_another_program_is_made_even_again(result: Result) -> None:
    (row,) = result.of("parity")
    assert (row["left"], row["taken"], row["error"]) == ("S", "E", None)
