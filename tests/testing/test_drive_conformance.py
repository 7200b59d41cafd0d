"""The conformance of our drives and of the example from outside; broken plugins fail it with a clear message."""

from __future__ import annotations

import dataclasses
import importlib
import re
import sys
from pathlib import Path
from typing import ClassVar

import pytest
from msgspec import structs

from dpstack.devices.finding import find
from dpstack.errors import DpError, DriveError, UsageError
from dpstack.profile import DriveCore, DriveProfile, Options, TelegramSpec
from dpstack.testing import BusFactory, DriveConformance

FUJI = find("fuji-frenic")
sys.path.append(str(Path(__file__).resolve().parents[2] / "examples" / "thirdparty_drive"))


class Quick(DriveConformance):
    """A slow bus has few telegrams to simulate."""

    baud: ClassVar[int | None] = 19_200
    rest_s = 5.0


class TestDemag(Quick):
    drive = "demag-dedrive"
    simulated = {"412": 1}
    fault = "F2100"


class TestFuji(Quick):
    drive = "fuji-frenic"


class TestImo(Quick):
    drive = "imo-hd2"
    options = {"baud_index": 1}  # 19.2 kbit/s: it answers at the rate of its own setting only
    simulated = {"P15.02": 1, "P15.13": 1, "P15.14": 11}  # the actual value 11 is the fault code
    has_quick_stop = False
    stops_when_lost = False


class TestKeb(Quick):
    drive = "keb-f5"
    stops_when_lost = False


class TestLs(Quick):
    drive = "ls-s100"
    stops_when_lost = False


class TestThirdParty(Quick):
    """As the author of a plugin writes it, before the package is installed."""

    profile = importlib.import_module("acme_drive").DRIVE
    telegrams = ("PKW", "STD")


def test_a_class_without_a_drive_says_so() -> None:
    with pytest.raises(UsageError, match=r'Quick: set drive = "NAME" or profile = DRIVE in the class'):
        Quick.dpstack_telegrams()


def test_a_telegram_of_another_length_fails() -> None:
    spec = structs.replace(FUJI.telegram("PPO3"), name="A", inputs=6)

    class Wrong(Quick):
        profile = dataclasses.replace(FUJI, telegrams={"A": spec}, default_telegram="A")

    with pytest.raises(AssertionError, match="A: its identifiers 71 have 4 octets of inputs and 4 of outputs"):
        Wrong().test_telegrams_have_the_lengths_of_their_identifiers()


def test_a_plugin_that_turns_the_wrong_way_fails(dpstack_bus: BusFactory) -> None:
    def turned(_profile: DriveProfile, name: str, telegram: TelegramSpec, _options: Options) -> DriveCore:
        core = FUJI.core(name, telegram.name, simulated=True)
        right = core.encode
        core.encode = lambda control, setpoint: right(control, -setpoint & 0xFFFF)  # type: ignore[method-assign]
        return core

    class Wrong(Quick):
        profile = dataclasses.replace(FUJI, core_factory=turned)

    with pytest.raises((AssertionError, DriveError)) as told:
        Wrong().test_set_points_in_each_direction(dpstack_bus, "PPO3")
    assert "set point" in str(told.value)


def test_a_simulated_drive_that_fails_is_named_with_the_place(dpstack_bus: BusFactory) -> None:
    acme = importlib.import_module("acme_drive").DRIVE
    device = importlib.import_module("acme_drive.simulator").AcmeDevice

    class Short(device):  # type: ignore[misc,valid-type]
        def scan(self, words: tuple[int, ...] | None, now: int) -> tuple[int, ...]:
            return (*super().scan(words, now)[:3],)

    class Wrong(Quick):
        profile = dataclasses.replace(acme, device_factory=Short)

    with pytest.raises(DpError, match="Stat_Diag") as told:
        Wrong().test_it_starts_and_stops(dpstack_bus, "STD")
    (note,) = told.value.__notes__
    assert re.fullmatch(
        r"simulation: slave 7 \(tested\): the device failed during Chk_Cfg \(ValueError: Short\.scan\(\) returned "
        r"\(8, 0, 0\); STD has 4 words of 0\.\.65535 \(.*\) in refresh\(\), device\.py line \d+\); correct and restart "
        r"it",
        note,
    )
    assert note in dpstack_bus.buses[0].report(0)


def test_a_plugin_that_fails_is_named_with_the_place(dpstack_bus: BusFactory) -> None:
    acme = importlib.import_module("acme_drive").DRIVE
    plugin = importlib.import_module("acme_drive.plugin").AcmeCore

    class Failing(plugin):  # type: ignore[misc,valid-type]
        def obstacle(self) -> str | None:
            raise ZeroDivisionError("of the plugin's")

    class Wrong(Quick):
        profile = dataclasses.replace(acme, core_factory=Failing)

    with pytest.raises(DriveError) as told:
        Wrong().test_it_starts_and_stops(dpstack_bus, "STD")
    place = r"ZeroDivisionError: of the plugin's, in obstacle\(\), test_drive_conformance\.py line \d+"
    assert re.fullmatch(f"drive tested: its plugin failed: {place}", str(told.value))
    assert re.search(rf"drive 7 \(tested\): its plugin failed: {place}", dpstack_bus.buses[0].report(0))


def test_a_trip_without_a_name_fails_unless_the_class_says_so(dpstack_bus: BusFactory) -> None:
    acme = importlib.import_module("acme_drive").DRIVE
    plugin = importlib.import_module("acme_drive.plugin").AcmeCore

    class Silent(plugin):  # type: ignore[misc,valid-type]
        inputs = ("status", "speed", "current")

    class Nameless(Quick):
        profile = dataclasses.replace(acme, core_factory=Silent)

    with pytest.raises(AssertionError, match=r"fault without a name: telegram STD does not carry it: give the plugin"):
        Nameless().test_a_fault_is_reported_and_acknowledged(dpstack_bus, "STD")

    class Declared(Nameless):
        names_faults = False

    Declared().test_a_fault_is_reported_and_acknowledged(dpstack_bus, "STD")


def test_a_plugin_without_a_simulated_drive_cannot_be_checked() -> None:
    class Real(Quick):
        profile = dataclasses.replace(FUJI, device_factory=None)

    with pytest.raises(UsageError, match="Real: fuji-frenic has no simulated drive, and the checks need one"):
        Real.dpstack_telegrams()
