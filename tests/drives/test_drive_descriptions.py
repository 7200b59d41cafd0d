"""The description of each drive, as its commissioning sheet shows it, against its plugin's tables and its manual."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import Final

import pytest

from dpstack.api.commissioning.sheet import Sheet, blocks_of, make_sheets
from dpstack.api.config.config import make_config
from dpstack.devices.finding import find
from dpstack.profile import DescribedPlace, DeviceDescription, DriveCore
from dpstack_drives.demag import table as demag
from dpstack_drives.fuji import table as fuji
from dpstack_drives.keb import table as keb
from dpstack_drives.ls import table as ls

#: all drives of the project, each once as a plain one and with what opens its other words
PLANTS: Final[tuple[Mapping[str, object], ...]] = (
    {"drive": "demag-dedrive"},
    {"drive": "demag-dedrive", "telegram": "PPO3"},
    {
        "drive": "demag-dedrive",
        "telegram": "PPO4",
        "options": {"control": "remote-contacts", "map_outputs": "reference"},
    },
    {"drive": "keb-f5"},
    {"drive": "keb-f5", "telegram": "PCH+8/8"},
    {"drive": "keb-f5", "options": {"control_bits": "run=2", "status_bits": "run=3 fault=1", "rpm_per_count": 0.5}},
    {"drive": "imo-hd2"},
    {"drive": "ls-s100"},
    {"drive": "ls-s100", "telegram": "PPO2", "options": {"profile": "ls"}},
    {"drive": "ls-s100", "telegram": "VENDOR 2/3"},
    {"drive": "ls-s100", "telegram": "ST1", "options": {"speed_unit": "rpm"}},
    {"drive": "fuji-frenic"},
    {"drive": "fuji-frenic", "telegram": "PPO4", "options": {"map_outputs": "S06", "map_inputs": "M16"}},
)
EACH: Final = pytest.mark.parametrize("keys", PLANTS, ids=lambda keys: " ".join(map(str, keys.values())))


def sheet_of(keys: Mapping[str, object], address: int = 3) -> Sheet:
    """The sheet of a drive with these keys of [[slave]]."""
    (sheet,) = make_sheets(make_config("virtual", 500_000, slaves=[{"name": "m", "address": address, **keys}]))
    return sheet


def described(address: int = 3, **keys: object) -> DeviceDescription:
    return sheet_of(keys, address).device


def text_of(sheet: Sheet) -> str:
    """All that people read, a line for each row."""
    lines: list[str] = []
    for block in blocks_of(sheet):
        lines += [block.title, *block.lines, *(" | ".join(row) for row in block.rows)]
    return "\n".join(lines)


def core_of(keys: Mapping[str, object]) -> DriveCore:
    options, telegram = keys.get("options"), keys.get("telegram")
    assert options is None or isinstance(options, Mapping)
    return find(str(keys["drive"])).core("m", None if telegram is None else str(telegram), options)


#: the messages of each drive's tables: code as the sheet has it, and text
TABLES: Final[Mapping[str, Callable[[], Iterable[tuple[str, str]]]]] = {
    "demag-dedrive": lambda: [
        *((f"F{code:04X}", text) for code, text in demag.FAULTS.items()),
        *((f"{1 << bit:04X}h (bit {bit} of 270)", text) for bit, text in enumerate(demag.WARNINGS)),
        *((str(code), text) for code, text in demag.PKW.errors.items()),
    ],
    "keb-f5": lambda: [("E.buS", "watchdog error"), *((str(code), text) for code, text in keb.ERRORS.items())],
    "imo-hd2": lambda: [
        ("SW bit 12", "overload pre-alarm"),
        *((str(code), text) for code, text in core_of({"drive": "imo-hd2"}).dialect.errors.items()),
    ],
    "ls-s100": lambda: [
        *((str(code), text) for code, text in ls.TRIPS.items()),
        *((f"{code:02X}h", text) for code, text in ls.PKW.errors.items()),
    ],
    "fuji-frenic": lambda: [
        *((f"{one.keypad} (M16: {one.code}, PNU 947: {one.malfunction:04X}h)", one.name) for one in fuji.ALARMS),
        *((str(code), text) for code, text in fuji.PKW.errors.items()),
    ],
}


@EACH
def test_every_code_of_the_tables_is_on_the_sheet(keys: Mapping[str, object]) -> None:
    lines = text_of(sheet_of(keys)).splitlines()
    expected = list(TABLES[str(keys["drive"])]())
    assert len(expected) >= 10
    for code, text in expected:
        assert any(line.startswith(f"{code} | {text}") for line in lines), (code, text)


@EACH
def test_notes_settings_bits_and_telegrams_of_the_plugin_are_on_the_sheet(keys: Mapping[str, object]) -> None:
    sheet, core, profile = sheet_of(keys), core_of(keys), find(str(keys["drive"]))
    text = text_of(sheet)
    for note in (*profile.notes, profile.on_loss):
        assert note in text
    steps = {step.what: step for step in sheet.device.steps}
    for setting in core.all_settings():
        step = steps[setting.wanted]
        assert setting.why
        assert setting.source
        assert (step.why, step.source) == (setting.why, setting.source)
        assert str(step.check) == ("start is refused" if setting.refuse else "notice")
    named = {(bit.bit, bit.name) for word in sheet.device.words for bit in word.bits}
    if profile.name != "demag-dedrive":  # its core sends the words of a mode only once it knows the mode
        for word in (core.table.control, core.table.status):
            assert {(bit, name) for name, bit in word.bits.items()} <= named
    for spec in (core.telegram, *profile.telegrams.values()):
        assert f"{spec.name} | {spec.config.hex(' ').upper()} | {spec.output_octets} | {spec.input_octets}" in text


@EACH
def test_no_fact_is_without_source_and_no_part_is_silently_empty(keys: Mapping[str, object]) -> None:
    sheet = sheet_of(keys)
    device = sheet.device
    messages = (*device.faults, *device.warnings, *device.errors)
    sources = [*(one.source for one in device.steps), *(one.source for one in device.ranges)]
    sources += [*(one.source for one in messages), *(one.source for one in device.leds)]
    assert all(source.strip() for source in sources)
    assert device.manual
    for block in blocks_of(sheet):
        assert block.rows or block.lines, block.title
    # what is made up for the simulated drive is no fact about a real one
    assert not [one for one in (*device.faults, *device.warnings) if one.source.startswith("made up")]


@EACH
def test_the_process_data_are_described_without_a_gap(keys: Mapping[str, object]) -> None:
    device, telegram = sheet_of(keys).device, core_of(keys).telegram

    def ends(places: tuple[DescribedPlace, ...]) -> int:
        at = 0
        for place in places:
            assert place.octet == at
            at += place.length
        return at

    assert (ends(device.outputs), ends(device.inputs)) == (telegram.output_octets, telegram.input_octets)


def test_demag_as_its_manual_has_it() -> None:
    device = described(drive="demag-dedrive", telegram="PPO2")
    assert device.ident == 0x0696
    assert [(one.octet, one.name) for one in device.inputs][1:] == [
        (8, "ZSW (status word)"),
        (10, "frequency"),
        (12, "absolute current"),
        (14, "active current"),
        (16, "warning (bits)"),
        (18, "fault (number)"),
    ]
    status = next(word for word in device.words if word.name.startswith("ZSW"))
    assert {(code.code, code.name) for code in status.codes} >= {
        ("0021h of 006Fh", "ready to switch on"),
        ("0027h of 006Fh", "running"),
        ("0008h of 004Fh", "fault"),
    }
    steps = {step.what: step for step in device.steps}
    assert steps["391 (Profibus Node-ID) = 3"].delivered == "126"
    assert steps["412 = 1"].source == "11.2.1"
    assert "hardware release wired and on: S1 and one of S2, S3" in steps
    assert [one.code for one in device.faults] == ["F2061", "F2062", "F2065", "F2100"]
    assert "15 s" in device.acknowledge
    itself = {step.what for step in described(drive="demag-dedrive", options={"set_412": True}).steps}
    assert "412 = 1" not in itself
    assert "412 = 1: nothing to set, start() writes it in RAM (option set_412)" in itself
    contacts = described(drive="demag-dedrive", options={"control": "remote-contacts"})
    assert "412 = 2" in {step.what for step in contacts.steps}
    assert (0, "s1") in {(bit.bit, bit.name) for bit in contacts.words[0].bits}


def test_fuji_as_its_manual_has_it() -> None:
    device = described(27, drive="fuji-frenic", telegram="PPO3", options={"reference_hz": 50})
    steps = {step.what: step for step in device.steps}
    assert "SW1 = 2, SW2 = 7" in steps
    assert steps["o30 = 3, then power off and on"].delivered == "0 (PPO1)"
    assert "F03 = 50 Hz" in steps
    assert (steps["y98 = 3"].delivered, str(steps["y98 = 3"].check)) == ("0", "start is refused")
    assert "SW1 = SW2 = 0, and o31 = 125" in {step.what for step in described(125, drive="fuji-frenic").steps}
    leds = {(led.name, led.shows): led for led in device.leds}
    assert "o30" in leds["ERR", "red, blinking"].remedy
    assert leds["PWR", "red"].meaning == "hardware error: Er4"
    er5 = next(one for one in device.faults if one.code.startswith("Er5 "))
    assert "(M16: 35, PNU 947: 7511h)" in er5.code
    assert "watchdog" in er5.remedy


def test_ls_as_its_manual_has_it() -> None:
    device = described(drive="ls-s100")
    assert {"dr-06 = 4", "dr-07 = 8", "dr-20 = 60 Hz", "COM-14 = 0"} <= {step.what for step in device.steps}
    leds = {(led.name, led.shows): led.meaning for led in device.leds}
    assert leds["CPU", "flashes every second"] == "normal"
    assert leds["ERROR", "double flash: 0.2 s on, 0.2 s off, 0.2 s on, 0.4 s off"].startswith("lost command")
    assert {led.name for led in device.leds} == {"CPU", "ERROR", "ONLINE"}
    other = described(drive="ls-s100", telegram="PPO1", options={"profile": "ls"})
    assert (13, "run_authority") in {(bit.bit, bit.name) for bit in other.words[0].bits}
    assert other.ranges[0].wire == "0.01 Hz a count"
    maps = {one.name: one.delivered for one in device.parameters}
    assert (maps["COM-31"], maps["COM-51"], maps["COM-30"]) == ("000Ah", "0005h", "3")


def test_keb_says_which_facts_its_manual_does_not_have() -> None:
    device = described(drive="keb-f5")
    assert device.ident is None
    assert [one.code for one in device.faults] == ["E.buS"]
    assert [word.bits for word in device.words] == [(), ()]
    assert all("options control_bits and status_bits" in word.codes[0].name for word in device.words)
    whats = [step.what for step in device.steps]
    assert whats[:2] == ["ud.01 = 440", "Fr.01 = -4"]  # this one undoes what is set before it
    assert whats.index("Fr.01 = -4") < whats.index("sy.06 (2006h) = 3")
    simulated = described(drive="keb-f5", options={"control_bits": "simulated", "status_bits": "simulated"})
    shown = {one.code: one.source for one in simulated.faults}
    assert set(shown) == {f"{name} (ru.00 = {number})" for name, number in keb.TRIPS.items()}
    assert shown["E.OC (ru.00 = 4)"] == "made up for the simulated drive"
    assert len([what for what in whats if what.startswith("oP.00")]) == 1


def test_imo_has_the_words_that_the_options_give() -> None:
    options = {"map_outputs": "set_frequency - torque", "fault_names": "4=OC1 11=OL1", "baud_index": 8, "max_hz": 60}
    device = described(drive="imo-hd2", options=options)
    steps = {step.what: step for step in device.steps}
    assert "P15.02 = 1 (set_frequency)" in steps
    assert "P15.04 = 4 (torque)" in steps
    assert "6000000 bit/s" in steps["baud rate of the card = 8 (by its number)"].why
    assert steps["P15.01 (Node address) = 3"].delivered == "2"
    assert [(one.code, one.text) for one in device.faults] == [("4", "OC1"), ("11", "OL1")]
    assert [one.name for one in device.outputs][2:5] == ["PZD2 (set_frequency)", "PZD3 (not used)", "PZD4 (torque)"]
    ranges = {one.name: (one.range, one.wire) for one in device.ranges}
    assert ranges["set_frequency (out)"] == ("0..60 Hz", "0.01 Hz a count")
    assert ranges["torque (out)"] == ("-300..300 %", "0.1 % a count, signed")
    # parameters of the inverter that are made up for the simulated drive are not on it
    assert not [one for one in device.parameters if one.name.startswith("P00.0")]
    assert "inverter's manual" in text_of(sheet_of({"drive": "imo-hd2"}))
