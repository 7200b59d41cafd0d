"""From exports to configurations: addresses, bus parameters, slaves with and without GSD files, symbols, remarks."""

from __future__ import annotations

import time
import tomllib
from pathlib import Path
from typing import Any

import pytest
from step7_kit import (
    CABINET,
    CPU,
    GATE,
    HEAD,
    PLANT,
    RACK_GSD,
    RACK_IO,
    STATION,
    SUBNET,
    SYSTEM,
    VALVES_GSD,
    address,
    gsd_folder,
    imported,
    remark_texts,
    section,
)

from dpstack.api.config.config import parse_config
from dpstack.api.gsd_folder import GsdFolder
from dpstack.api.gsd_orders import FolderFinder
from dpstack.errors import ConfigError
from dpstack.toml.reading import table_lines


def toml_of(text: str) -> dict[str, Any]:
    return tomllib.loads(text)


def slaves_of(text: str = PLANT, **how: Any) -> dict[int, dict[str, Any]]:
    return {slave["address"]: slave for slave in toml_of(imported(text, **how).text)["slave"]}


@pytest.fixture
def finder(tmp_path: Path) -> FolderFinder:
    return FolderFinder(GsdFolder(gsd_folder(tmp_path / "gsd"), beside=tmp_path))


def one_slave(*slots: str, head: str = '"A.GSD", "x"', keys: tuple[str, ...] = ('PNO_IDENT_NO "1"',)) -> str:
    return HEAD + SUBNET + CPU + SYSTEM + section(f"DPSUBSYSTEM 1, DPADDRESS 9, {head}", *keys) + "".join(slots)


def slot(number: int, config: str, *lines: str, title: str = "module") -> str:
    octets = bytes.fromhex(config)
    length = f"{len(octets):02X} 00 {octets.hex(' ').upper()}"
    return section(f'DPSUBSYSTEM 1, DPADDRESS 9, SLOT {number}, "{title}", "8DE"', f'SLAVE_CFG_DATA "{length}"', *lines)


def test_the_bus_as_in_the_export_and_read_only() -> None:
    assert toml_of(imported().text)["bus"] == {
        "baud": 1_500_000,
        "address": 3,
        "read_only": True,
        "hsa": 126,
        "t_sl": 300,
        "t_tr": 30_000,
        "gap": 10,
        "max_retry": 1,
    }
    assert "`dpstack run` of this file joins the token ring of the PLC" in imported().text


def test_the_address_is_one_that_no_station_has_and_that_the_masters_look_for() -> None:
    stations = "".join(section(f'DPSUBSYSTEM 1, DPADDRESS {a}, "A.GSD", ""', 'PNO_IDENT_NO "1"') for a in range(3, 8))
    panel = section(
        'RACK 0, SLOT 5, "6GK7 342-5DA03-0XE0", "CP"', 'PROFIBUSADDRESS "8"', 'LINKED_SUBNETNAME "PROFIBUS(1)"'
    )
    assert imported(HEAD + SUBNET + CPU + panel + SYSTEM + stations).address == 9
    low = SUBNET.replace('HSA "126"', 'HSA "7"')
    assert imported(HEAD + low + CPU + SYSTEM + stations).address == 1  # the PLC has 2, 0 comes last


@pytest.mark.parametrize(
    ("said", "t_sl", "baud", "why"),
    [
        ("187.5_KBPS", 100, 187_500, ""),
        ("45.45_KBPS", 640, 45_450, ""),
        ("12_MBPS", 1000, 12_000_000, ""),
        ("", 400, 3_000_000, "no PROFIBUS_BAUDRATE; PROFIBUS_TSL 400 is that of 3 Mbit/s: check it with dpstack baud"),
        (
            "",
            100,
            None,
            "the baud rate is not in the export: export subnets and default values, too, or find it with dpstack baud",
        ),
        ("7_MBPS", 300, None, "PROFIBUS_BAUDRATE 7_MBPS is no rate of PROFIBUS: give baud by hand"),
    ],
)
def test_the_baud_rate(said: str, t_sl: int, baud: int | None, why: str) -> None:
    keys = [f'PROFIBUS_BAUDRATE "{said}"'] if said else []
    subnet = section('SUBNET PROFIBUS , "PROFIBUS(1)"', *keys, f'PROFIBUS_TSL "{t_sl}"')
    plant = imported(HEAD + subnet + CPU + SYSTEM)
    assert plant.baud == baud
    assert [one for one in remark_texts(plant) if "BAUDRATE" in one or "baud" in one] == ([why] if why else [])


def test_a_slave_without_its_gsd_file_has_the_octets_of_the_export() -> None:
    found = slaves_of()[10]
    assert found["ident"] == 0x5678
    assert found["config"] == "00 53 10 20"
    assert found["user_prm"] == "00 11 22 33 44"
    assert found["groups"] == [1, 2]
    assert found["name"] == "Hauptschrank"


def test_user_parameters_with_fail_safe_stay_as_they_are() -> None:
    found = slaves_of(PLANT.replace("05 00 00 11 22 33 44", "03 00 C4 00 00"))[10]
    assert (found["user_prm"], found["fail_safe"]) == ("C4 00 00", True)
    (slave,) = parse_config(toml_text(found)).slave_params
    assert slave.user_octets(None) == bytes.fromhex("C4 00 00")


def toml_text(slave: dict[str, Any]) -> str:
    keys = {key: slave[key] for key in ("name", "address", "ident", "config", "user_prm", "fail_safe")}
    return "\n".join(table_lines("[bus]", {"port": "virtual", "baud": 500_000}) + table_lines("[[slave]]", keys))


def test_symbols_are_bits_and_words_of_the_right_slots() -> None:
    slaves = slaves_of()
    assert slaves[10]["inputs"] == {
        "Füllstand": "i16@0",
        "H19_N_IST": "i16@2",
        "NA_INT": "bool@8.3",
        "NA_EXT": "bool@8.4",
    }
    assert slaves[10]["outputs"] == {"H8_EBE": "bool@0.0", "Horn": "bool@0.7"}
    lines = imported().text.splitlines()
    assert 'NA_INT = "bool@8.3"  # I 3.3: Not-Aus intern betätigt -3S1' in lines
    assert 'H19_N_IST = "i16@2"  # IW 286 \'H19.N_IST\': Istwert "H19" - FU' in lines
    assert "# slot 3: 8DI 24V DC, 8DE; I 3" in lines
    assert "names that a configuration cannot have are changed, the file has both: 'H19.N_IST'" in remark_texts(
        imported()
    )


def test_analogue_modules_of_siemens_count_channels() -> None:
    assert slaves_of()[12]["inputs"] == {"Tor_zu": "bool@1.1", "T_Lager": "i16@4", "T_Getriebe": "i16@12"}


@pytest.mark.parametrize(
    ("config", "octets", "number", "name", "place"),
    [
        ("94", 5, 0, "PEW 270", None),  # the name says another address
        ("93", 4, 2, "PEW 258", "i16@2"),
        ("93", 4, 1, "EB257", "u8@1"),
        ("93", 4, 0, "PED_256", "i32@0"),
        ("93", 4, 9, "E 257.1", "bool@1.1"),
        ("93", 4, 0, "level", None),
        ("90", 1, 7, "level", "bool@0.7"),
        ("93", 4, 4, "level", "bool@0.4"),  # no octet has the number 4: a bit
        ("42 84 08 05", 5, 0, "level", "f32@0"),
        ("53", 8, 3, "level", "i16@6"),  # an odd number: channels
        ("53", 8, 8, "level", None),
        ("40 81", 4, 2, "level", "bool@0.2"),
    ],
)
def test_the_kind_of_a_symbol_as_far_as_the_file_says_it(
    config: str, octets: int, number: int, name: str, place: str | None
) -> None:
    text = one_slave(slot(1, config, *address("IN", 256, octets), f'SYMBOL  I , {number}, "{name}", ""'))
    found = slaves_of(text)[9].get("inputs", {})
    assert list(found.values()) == ([] if place is None else [place])
    lost = [one for one in remark_texts(imported(text)) if repr(name) in one and "has no place" in one]
    assert len(lost) == (place is None)


def test_packed_addresses_keep_the_slave_and_name_the_symbols() -> None:
    text = one_slave(slot(1, "10", *address("IN", 4, 1, bit=4), 'SYMBOL  I , 0, "door", ""'))
    assert "inputs" not in slaves_of(text)[9]
    assert any("places of door are not known" in one for one in remark_texts(imported(text)))


#: four bits each in one octet, then a word that must not move
PACKED = (
    ('"6ES7 131-4BD01-0AA0", "4DI"', (*address("IN", 60, 1), 'SYMBOL  I , 3, "stop", ""')),
    ('"6ES7 131-4BD01-0AA0", "4DI"', (*address("IN", 60, 1, bit=4), 'SYMBOL  I , 1, "flap", "shut"')),
    ('"6ES7 134-4FB01-0AB0", "2AI"', (*address("IN", 512, 4), 'SYMBOL  I , 1, "level", ""')),
)


def packed_station(order: str = "6ES7 151-1AA05-0AB0") -> str:
    modules = "".join(
        section(f"DPSUBSYSTEM 1, DPADDRESS 9, SLOT {number}, {head}", *lines)
        for number, (head, lines) in enumerate(PACKED, 4)
    )
    return HEAD + STATION + SUBNET + CPU + SYSTEM + section(f'DPSUBSYSTEM 1, DPADDRESS 9, "{order}", "rack"') + modules


def test_modules_with_packed_addresses_share_an_octet() -> None:
    slave = slaves_of(packed_station())[9]
    assert slave["config"] == "40 80 00 40 83"  # 5 octets of inputs
    assert slave["inputs"] == {"stop": "bool@0.3", "flap": "bool@0.5", "level": "i16@3"}
    plant = imported(packed_station())
    assert 'flap = "bool@0.5"  # I 60.5: shut' in plant.text
    assert "# slot 5: 6ES7 131-4BD01-0AA0, 4DI; I 60.4" in plant.text
    assert any("slave 9: packed addresses: the bits of slot 5 stand" in one for one in remark_texts(plant))


def test_numbers_of_packed_modules_that_can_only_count_from_bit_0() -> None:
    text = packed_station().replace('SYMBOL  I , 1, "flap"', 'SYMBOL  I , 6, "flap"')
    assert slaves_of(text)[9]["inputs"]["flap"] == "bool@0.6"


def test_packed_addresses_of_a_module_without_an_octet_of_its_own() -> None:
    more = slot(2, "00", *address("IN", 4, 1, bit=4), 'SYMBOL  I , 3, "door", ""', 'SYMBOL  I , 9, "far", ""')
    text = one_slave(slot(1, "10", *address("IN", 4, 1)) + more)
    assert slaves_of(text)[9]["inputs"] == {"door": "bool@0.3"}
    assert any("'far' has no place: number 9 lies outside" in one for one in remark_texts(imported(text)))


@pytest.mark.parametrize("name", ["6ES7 131-4BD01-0AA0 4DI", "*6ES7 131-4BD01-0AA0 4DI"])
def test_packed_modules_by_order_number(tmp_path: Path, name: str) -> None:
    """The file must have a module without octets for the second one, else it is not used."""
    text = RACK_GSD.replace("153-1AA0?", "151-1AA05").replace("331-1KF01", "134-4FB01").replace("0x57", "0x51")
    modules = {"6ES7 131-4BD01-0AA0 4DI": "0x10"} | ({name: "0x00"} if "*" in name else {})
    (tmp_path / "rack.gsd").write_text(text + "".join(f'Module = "{a}" {b}\nEndModule\n' for a, b in modules.items()))
    slave = slaves_of(packed_station(), finder=FolderFinder(GsdFolder(tmp_path)))[9]
    assert slave.get("modules", ["", ""])[1] == (name if "*" in name else "")
    assert slave["inputs"] == {"stop": "bool@0.3", "flap": "bool@0.5", "level": "i16@3"}


def test_another_length_than_that_of_the_identifier_is_a_remark() -> None:
    text = one_slave(slot(1, "11", *address("IN", 4, 1), 'SYMBOL  I , 0, "door", ""'))
    assert any(
        "ADDRESS gives 1 octets of inputs, its identifier octets 2" in one for one in remark_texts(imported(text))
    )


def test_the_same_name_twice_and_the_same_place_twice() -> None:
    symbols = ('SYMBOL  O , 0, "pump", ""', 'SYMBOL  O , 1, "pump", ""', 'SYMBOL  O , 1, "valve", ""')
    text = one_slave(slot(1, "20", *address("OUT", 4, 1), *symbols))
    assert slaves_of(text)[9]["outputs"] == {"pump": "bool@0.0", "pump_2": "bool@0.1"}
    texts = remark_texts(imported(text))
    assert any("output 'valve' has the place of another name: left out" in one for one in texts)
    assert any("'pump'" in one and "are changed" in one for one in texts)


def test_empty_slots_and_missing_ones() -> None:
    text = one_slave(slot(1, "10"), slot(4, "20"))
    assert slaves_of(text)[9]["config"] == "10 00 00 20"


def test_with_the_gsd_file_modules_have_its_names(finder: FolderFinder) -> None:
    found = slaves_of(finder=finder)[10]
    assert found["gsd"] == "gsd/valv5678.gse"  # the export names it .GSG
    assert found["modules"] == ["coupler", "4AI 0-20mA", "8DI 24V DC", "8DO 24V DC"]
    assert found["user_prm"] == "00 11 22 33 44"  # the file makes 00 11 22 33 00
    assert "config" not in found
    same = PLANT.replace("05 00 00 11 22 33 44", "05 00 00 11 22 33 00")
    assert "user_prm" not in slaves_of(same, finder=finder)[10]


def test_a_gsd_file_that_says_something_else_gives_place_to_the_octets(tmp_path: Path) -> None:
    folder = gsd_folder(tmp_path / "gsd")
    (folder / "valv5678.gse").write_text(VALVES_GSD.replace('"8DI 24V DC" 0x10', '"8DI 24V DC" 0x11'))
    plant = imported(finder=FolderFinder(GsdFolder(folder)))
    assert toml_of(plant.text)["slave"][0]["config"] == "00 53 10 20"
    assert any(
        "valv5678.gse does not fit: its modules of these names have other identifier" in r for r in remark_texts(plant)
    )
    (folder / "valv5678.gse").write_text(VALVES_GSD.replace("0x5678", "0x5679"))
    plant = imported(finder=FolderFinder(GsdFolder(folder)))
    assert any("its Ident_Number is 0x5679, the export says 0x5678" in one for one in remark_texts(plant))


def test_siemens_own_slaves_by_order_number(finder: FolderFinder) -> None:
    plant = imported(finder=finder)
    found = toml_of(plant.text)["slave"][1]
    assert found["gsd"] == "gsd/etm_801d.gsd"
    assert found["modules"] == ["6ES7 321-1BH02-0AA0 16DI", "6ES7 331-1KF01-0AB0 8AI"]
    assert found["inputs"] == {"Tor_zu": "bool@1.1", "T_Lager": "i16@4", "T_Getriebe": "i16@12"}
    assert "refuse_master" not in found
    assert any("STEP 7 may send other octets to its own slaves" in one for one in remark_texts(plant))


def test_an_unknown_order_number_is_one_remark_and_keeps_the_names(tmp_path: Path) -> None:
    folder = gsd_folder(tmp_path / "gsd")
    (folder / "etm_801d.gsd").write_text(RACK_GSD.replace("6ES7 331-1KF01", "6ES7 331-7KF02"))
    plant = imported(finder=FolderFinder(GsdFolder(folder)))
    found = toml_of(plant.text)["slave"][1]
    assert any("has no module 6ES7 331-1KF01-0AB0 (slot 5)" in one for one in remark_texts(plant))
    assert (found["ident"], found["config"]) == ("ask", "40 81 40 8F")
    assert "right lengths only" in found["refuse_master"]
    assert found["inputs"]["T_Lager"] == "i16@4"
    (folder / "etm_801d.gsd").unlink()
    texts = remark_texts(imported(finder=FolderFinder(GsdFolder(folder))))
    assert sum("slave 12 (6ES7 153-1AA03-0XB0): ident number" in one for one in texts) == 1
    assert sum("takes any of the right lengths; no GSD file of the folder fits" in one for one in texts) == 1


def test_slaves_of_one_order_number_without_their_octets_are_one_remark() -> None:
    more = "".join(RACK_IO.replace("DPADDRESS 12", f"DPADDRESS {address}") for address in (20, 21, 22))
    assert [one for one in remark_texts(imported(PLANT + more)) if "identifier octets are not in" in one] == [
        "slaves 12, 20 to 22 (6ES7 153-1AA03-0XB0): ident number and identifier octets are not in the export: "
        "listening shows the names, a simulation takes any of the right lengths; give their GSD file (--gsd)"
    ]


def test_comments_of_station_and_subnet_stand_in_the_file() -> None:
    text = imported(
        PLANT.replace('COMMENT ""', 'COMMENT "Cabinet 2"').replace('PROFIBUS_GAP "10"', 'COMMENT "Cable A"')
    ).text
    assert "\n# Cabinet 2\n" in text
    assert '[bus]\n# port = "/dev/ttyUSB0"  # or --port\n# Cable A\n' in text


@pytest.mark.parametrize(
    ("named", "found"),
    [
        ("6ES7 153-1AA03-0XB0", True),
        ("6ES7153-1AA03-0XB0", True),
        ("6ES7 153-1AA??-0XB0", True),
        ("6ES7 153-1xAxx-xxxx", True),
        ("6ES7 153-1AA82-0XB0", False),
        ("6ES7 153-2AA03-0XB0", False),
    ],
)
def test_order_numbers_with_placeholders(tmp_path: Path, named: str, found: bool) -> None:
    folder = gsd_folder(tmp_path / "gsd")
    (folder / "etm_801d.gsd").write_text(RACK_GSD.replace("6ES7 153-1AA0?-0XB0", named))
    assert bool(FolderFinder(GsdFolder(folder)).with_order("6ES7 153-1AA03-0XB0")) is found


def test_f_modules_are_for_listening_and_simulation() -> None:
    plant = imported()
    found = toml_of(plant.text)["slave"][2]
    assert found["refuse_master"] == "F modules (PROFIsafe) in slot 1: dpstack is no F-host"
    assert found["config"] == "C0 83 85"
    expected = (
        "slave 14 (Tor): for listening and simulation only: F modules (PROFIsafe) in slot 1: dpstack is no F-host"
    )
    assert expected in remark_texts(plant)


def test_f_modules_by_order_number_and_by_gsd_file(tmp_path: Path) -> None:
    own = RACK_IO.replace("6ES7 321-1BH02-0AA0", "6ES7 326-1BK01-0AB0")
    assert "F modules (PROFIsafe) in slot 4" in slaves_of(HEAD + SUBNET + CPU + SYSTEM + own)[12]["refuse_master"]
    folder = gsd_folder(tmp_path / "gsd")
    f_data = "0x10\nF_Ext_Module_Prm_Data_Len = 14"
    (folder / "valv5678.gse").write_text(VALVES_GSD.replace('DC" 0x10', f'DC" {f_data}'))
    found = slaves_of(finder=FolderFinder(GsdFolder(folder)))[10]
    assert found["refuse_master"] == "F modules (PROFIsafe): dpstack is no F-host"


SECOND = (
    'SUBNET PROFIBUS , "PROFIBUS(2)"',
    'DPSUBSYSTEM 2, "PROFIBUS(2): DP-Mastersystem (2)"',
    'DPSUBSYSTEM 2, DPADDRESS 10, "PUMP1111.GSD", "Pumpe"',
)


def second_system() -> str:
    return (
        section(SECOND[0], 'PROFIBUS_BAUDRATE "500_KBPS"')
        + section(SECOND[1], 'SUBNET_NAME "PROFIBUS(2)"')
        + section(SECOND[2], 'PNO_IDENT_NO "4369"')
        + section('DPSUBSYSTEM 2, DPADDRESS 10, SLOT 1, "DI", "8DE"', 'SLAVE_CFG_DATA "01 00 10"')
    )


def test_several_dp_systems_are_chosen_by_number() -> None:
    text = PLANT + second_system()
    with pytest.raises(ConfigError) as caught:
        imported(text)
    assert str(caught.value) == (
        'has 2 DP systems, each a cable of its own; choose one by --system: 1 "PROFIBUS(1): DP-Mastersystem (1)" '
        '(3 slaves); 2 "PROFIBUS(2): DP-Mastersystem (2)" (1 slave)'
    )
    assert [slave.name for slave in imported(text, 2).slaves] == ["Pumpe"]
    assert imported(text, 2).baud == 500_000
    assert slaves_of(text, system=1).keys() == {10, 12, 14}
    left = 'DP system 2 "PROFIBUS(2): DP-Mastersystem (2)" (1 slave) is left out: --system 2 makes a file of it'
    assert left in remark_texts(imported(text, 1))
    with pytest.raises(ConfigError, match="has no DP system 7; it has 1 "):
        imported(text, 7)


def test_a_redundant_slave_stands_on_both_cables() -> None:
    head, *slots = RACK_IO.partition("DPSUBSYSTEM 1, DPADDRESS 12, SLOT 4")
    redundant = head.replace('"Halle 2"\r\n', '"Halle 2"\r\nREDUNDANT \r\n')
    interface = section(
        'DPSUBSYSTEM 1, DPADDRESS 12, SLOT 2, "6ES7 153-1AA03-0XB0", "IM"',
        'PROFIBUSADDRESS "12"',
        'LINKED_SUBNETNAME "PROFIBUS(2)"',
    )
    text = HEAD + SUBNET + CPU + SYSTEM + redundant + interface + "".join(slots) + second_system()
    assert slaves_of(text, system=2)[12]["inputs"] == slaves_of(text, system=1)[12]["inputs"]
    assert any("it has two interfaces" in one for one in remark_texts(imported(text, 1)))


def test_a_second_interface_at_the_address_of_another_slave() -> None:
    interface = section(
        'DPSUBSYSTEM 1, DPADDRESS 12, SLOT 2, "6ES7 153-1AA03-0XB0", "IM"',
        'PROFIBUSADDRESS "10"',
        'LINKED_SUBNETNAME "PROFIBUS(2)"',
    )
    plant = imported(PLANT + interface + second_system(), 2)
    assert [slave.name for slave in plant.slaves] == ["Pumpe"]
    assert "slave 10: another slave of DP system 2 has the address of this interface" in remark_texts(plant)


def test_slots_far_apart_are_no_empty_slots() -> None:
    text = one_slave(slot(1, "10", *address("IN", 0, 1)), slot(999_999_999, "20"))
    assert slaves_of(text)[9]["config"] == "40 80"
    assert any("no slave has so many slots" in one for one in remark_texts(imported(text)))


def test_a_gsd_slave_without_slots_has_the_modules_that_its_file_presets(tmp_path: Path) -> None:
    folder = gsd_folder(tmp_path / "gsd")
    (folder / "a.gsd").write_text(VALVES_GSD.replace('"coupler" 0x00', '"all" 0x31\nPreset=1'))
    text = one_slave(keys=('PNO_IDENT_NO "22136"',))
    assert slaves_of(text, finder=FolderFinder(GsdFolder(folder)))[9]["gsd"] == "a.gsd"


def test_no_dp_system_and_one_without_slaves() -> None:
    with pytest.raises(ConfigError, match="has no DP master system"):
        imported(HEAD + STATION)
    plant = imported(HEAD + STATION + SUBNET + CPU + SYSTEM)
    assert "slave" not in toml_of(plant.text)
    assert "DP system 1 has no slaves" in remark_texts(plant)


def test_what_is_not_on_the_bus_is_left_out_with_a_remark() -> None:
    central = section('RACK 0, SLOT 4, "6ES7 321-1BH02-0AA0", "DI"', *address("IN", 0, 2), 'SYMBOL  I , 0, "a", ""')
    device = section('IOSUBSYSTEM 100, IOADDRESS 1, "GSDML.xml", "camera"')
    sub = section(
        'DPSUBSYSTEM 1, DPADDRESS 10, SLOT 3, SUBSLOT 1, "port", "p"',
        *address("IN", 90, 2),
        'SYMBOL  I , 0, "pressure", ""',
    )
    texts = remark_texts(imported(PLANT + central + device + sub))
    assert "1 symbol of central modules (RACK), which no bus carries: left out" in texts
    assert "1 device of PROFINET (IOSUBSYSTEM), not of PROFIBUS: left out" in texts
    assert "the parameters (PARAMETER) of 2 modules are left out: STEP 7 sends them in its own way" in texts
    assert (
        "slave 10, slot 3 (port): a SUBSLOT is left out: I 90 to 91, pressure; names of the slots behind it may "
        + ("have wrong places: compare one with the PLC")
        in texts
    )


def test_an_export_that_was_cut_in_front_of_its_dp_system_says_so() -> None:
    with pytest.raises(ConfigError, match="was cut within the section of line 14, in front of"):
        imported(HEAD + STATION + SUBNET[:-10])


def test_a_slave_that_no_configuration_can_hold_stands_as_comments() -> None:
    plant = imported(refused="Hauptschrank")
    assert [(slave.name, slave.active) for slave in plant.slaves] == [
        ("Hauptschrank", False),
        ("Halle 2", True),
        ("Tor", True),
    ]
    assert '# NA_INT = "bool@8.3"  # I 3.3: Not-Aus intern betätigt -3S1' in plant.text.splitlines()
    assert "# slave 10 stands as comments: Hauptschrank is refused" in plant.text.splitlines()
    assert toml_of(plant.text)["slave"][0]["name"] == "Halle 2"


def test_names_of_slaves_are_words_and_unique() -> None:
    def named(number: int, name: str) -> str:
        head = f'DPSUBSYSTEM 1, DPADDRESS {number}, "A.GSD", "{name}"'
        return section(head, 'PNO_IDENT_NO "1"') + slot(1, "10").replace("DPADDRESS 9", f"DPADDRESS {number}")

    text = HEAD + SUBNET + CPU + SYSTEM + named(5, "17") + named(6, "Pumpe") + named(7, "Pumpe") + named(8, "")
    assert [slave.name for slave in imported(text).slaves] == ["slave5", "Pumpe", "Pumpe-7", "slave8"]


def test_500_slaves_are_read_at_once_and_the_impossible_addresses_named_in_one_line() -> None:
    parts = [HEAD, SUBNET, CPU, SYSTEM]
    for number in range(3, 503):
        parts.append(section(f'DPSUBSYSTEM 1, DPADDRESS {number}, "A.GSD", "s{number}"', 'PNO_IDENT_NO "1"'))
        lines = (*address("IN", number, 1), 'SYMBOL  I , 0, "H1.2", ""')
        parts.append(slot(1, "10", *lines).replace("DPADDRESS 9", f"DPADDRESS {number}"))
    begun = time.process_time()
    plant = imported("".join(parts), refused="no slave of this name")
    assert time.process_time() - begun < 5
    assert len(plant.slaves) == 500
    assert remark_texts(plant) == [
        "377 slaves have addresses above 125 (126 to 502), which PROFIBUS does not have: they stand as comments",
        "names that a configuration cannot have are changed, the file has both: 'H1.2'",
    ]


def test_octets_of_the_export_that_contradict_their_length() -> None:
    text = PLANT.replace('"05 00 00 11 22 33 44"', '"06 00 00 11 22 33 44"')
    assert "user_prm" not in slaves_of(text)[10]
    assert any("NORMSLAVE_PARAM_DATA is not its length" in one for one in remark_texts(imported(text)))
    text = PLANT.replace('SLAVE_CFG_DATA "01 00 53"', 'SLAVE_CFG_DATA "01 00 5G"')
    found = slaves_of(text)[10]
    assert found["config"] == "40 87 40 80 80 80"  # lengths by the addresses
    assert found["inputs"]["NA_INT"] == "bool@8.3"


def test_a_slave_without_a_section_of_its_own_and_slots_twice() -> None:
    text = HEAD + SUBNET + CPU + SYSTEM + CABINET[CABINET.index("DPSUBSYSTEM 1, DPADDRESS 10, SLOT 1") :] + GATE + GATE
    texts = remark_texts(imported(text))
    assert "slave 10: its own section is missing" in texts
    assert "slave 14: it stands twice in DP system 1; the first one counts" in texts
    assert any("slot 1 stands twice; the first one counts" in one for one in texts)
