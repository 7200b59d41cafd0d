"""The key ``subscribes``: filter and Publisher_Enable in Set_Prm, and what is refused."""

from __future__ import annotations

from pathlib import Path

import pytest

from dpstack.api.bus.compose import plan_bus
from dpstack.api.config.config import Config, parse_config
from dpstack.errors import ConfigError

PUBLISHER = """
[[slave]]
name = "encoder"
address = 7
ident = 0x1111
config = "13 23"
user_prm = "00 00 00"
dpv1 = true
"""
SUBSCRIBER = """
[[slave]]
name = "valve"
address = 9
ident = 0x1234
config = "15 21 23"
user_prm = "00 00 00"
dpv1 = true
"""
ENTRY = 'subscribes = [{ from = "encoder", octets = "1:3", to = 3 }]'


def read(subscriber: str = ENTRY, publisher: str = "", head: str = "baud = 500000") -> Config:
    return parse_config(f'[bus]\nport = "virtual"\n{head}\n{PUBLISHER}{publisher}{SUBSCRIBER}{subscriber}\n')


def prms(config: Config) -> list[str]:
    return [slave.set_prm for slave in plan_bus(config).slaves]


def test_the_octets_of_set_prm() -> None:
    """Min T_SDR of the publisher 39 at 500 kbit/s, Publisher_Enable; the subscriber table behind DPV1_Status."""
    first, second = prms(read())
    assert first[6:] == "27" + "1111" + "00" + "a00000"
    assert second[6:] == "0b" + "1234" + "00" + "800008" + "0b070000" + "01" + "070401030102"


@pytest.mark.parametrize(
    ("keys", "block"),
    [
        (ENTRY, "0b070000 01 07 04 01 03 01 02"),
        ('subscribes = [{ from = 7, octets = "0:4" }]', "09030000 01 07 04 00 04"),
        (f'filter_block = "sinamics"\n{ENTRY}', "0ce20000 e2 01 03 07 04 01 03 02"),
    ],
)
def test_the_filters(keys: str, block: str) -> None:
    assert prms(read(keys))[1].endswith("800008" + block.replace(" ", ""))


def test_reading_it_again_changes_nothing() -> None:
    config = read()
    assert prms(config.with_bus(gap=0)) == prms(config)


def test_the_publisher_answers_later_in_the_plan() -> None:
    with_links = plan_bus(read()).figures
    without = plan_bus(read("")).figures
    publisher = (with_links.rotations, without.rotations)
    more, less = (next(iter(found.values())).slaves[7] for found in publisher)
    assert more - less == 39 - 11
    assert read("").slaves[0].params.publishes is False


def test_a_publisher_whose_turn_comes_too_seldom() -> None:
    config = parse_config(
        f'[bus]\nport = "virtual"\nbaud = 500000\n{PUBLISHER}every = 200\n{SUBSCRIBER}watchdog_ms = 200\n{ENTRY}\n'
    )
    (finding,) = (text for text in plan_bus(config).findings if "monitors its links" in text)
    assert "slave 9 (valve): its watchdog of 200 ms monitors its links, and slave 7 (encoder) may have its" in finding


BAD = [
    ('subscribes = "encoder"', "is no list of tables; write subscribes"),
    ("subscribes = [{}]", "is no list of tables"),
    ('subscribes = [{ octets = "0:4" }]', "no from; write"),
    ('subscribes = [{ from = "encoder" }]', "no octets; write"),
    ('subscribes = [{ from = "encoder", octets = "4" }]', "octets = '4'; write the first octet"),
    ('subscribes = [{ from = "encoder", octets = "4:4" }]', "write the first octet"),
    ('subscribes = [{ from = "encoder", octets = "0:245" }]', "up to 244"),
    ('subscribes = [{ from = "encodr", octets = "0:4" }]', "there is no slave 'encodr'; did you mean encoder?"),
    ('subscribes = [{ from = "valve", octets = "0:4" }]', "its publisher is this slave itself"),
    ('subscribes = [{ from = "encoder", octets = "0:5", to = 0 }]', "octets 0:5, encoder has 4 octets of inputs"),
    ('subscribes = [{ from = "encoder", octets = "0:4", to = 3 }]', "octets 3..6, this slave has 6 octets of outputs"),
    ('subscribes = [{ from = "encoder", octets = "0:4", to = 0 }]', "lie in several slots; write an entry for each"),
    (
        'subscribes = [{ from = "encoder", octets = "0:1", to = 0 }, { from = "encoder", octets = "0:1" }]',
        "subscribes 2: no to; say to which octet",
    ),
    (
        'subscribes = [{ from = "encoder", octets = "0:2", to = 2 }, { from = "encoder", octets = "2:4", to = 3 }]',
        "both give output octet",
    ),
    (f"{ENTRY}\nwatchdog_ms = 0", "it subscribes with watchdog_ms = 0"),
    (f'{ENTRY}\noutputs = {{ valve = "u8@4" }}', "outputs come from encoder, and valve is there; take valve out"),
    (f"{ENTRY}\nfilter_block = 3", "filter_block = 3 is an integer"),
    ('filter_block = "sinamics"\nsubscribes = [{ from = "encoder", octets = "0:4" }]', "no to"),
]


@pytest.mark.parametrize(("keys", "problem"), BAD)
def test_what_is_refused(keys: str, problem: str) -> None:
    with pytest.raises(ConfigError) as error:
        read(keys)
    assert problem in str(error.value)
    assert str(error.value).startswith("config:")
    assert "\n" not in str(error.value)


def test_dp_v1_is_needed_at_both_ends() -> None:
    with pytest.raises(ConfigError, match=r"slave encoder: it publishes, and dpv1 is off"):
        parse_config(f'[bus]\nport = "virtual"\nbaud = 500000\n{PUBLISHER.replace("true", "false")}{SUBSCRIBER}{ENTRY}')
    with pytest.raises(ConfigError, match=r"slave valve: it subscribes, and dpv1 is off"):
        parse_config(f'[bus]\nport = "virtual"\nbaud = 500000\n{PUBLISHER}{SUBSCRIBER.replace("true", "false")}{ENTRY}')


GSD = """#Profibus_DP
GSD_Revision = 5
Vendor_Name = "Nobody"
Model_Name = "Both"
Revision = "1"
Ident_Number = 0x1234
Protocol_Ident = 0
Station_Type = 0
Hardware_Release = "1"
Software_Release = "1"
500_supp = 1
MaxTsdr_500 = 100
Modular_Station = 0
Max_Diag_Data_Len = 64
Max_User_Prm_Data_Len = 100
DPV1_Slave = 1
C1_Read_Write_supp = 1
C1_Max_Data_Len = 240
C1_Response_Timeout = 100
Prm_Block_Structure_supp = 1
Publisher_supp = 1
Subscriber_supp = 1
DXB_Max_Link_Count = 2
DXB_Max_Data_Length = 3
Ext_User_Prm_Data_Const(0) = 0x00,0x00,0x00
Module = "4 in 4 out" 0x13,0x23
1
EndModule
"""


def by_gsd(
    folder: Path, old: str = "", new: str = "", entries: str = '{ from = "a", octets = "0:1", to = 0 }'
) -> Config:
    path = folder / "both.gsd"
    path.write_text(GSD.replace(old, new, 1) if old else GSD)
    slave = f'\n[[slave]]\naddress = {{}}\nname = "{{}}"\ngsd = "{path}"\n'
    text = f'[bus]\nport = "virtual"\nbaud = 500000\n{slave.format(7, "a")}{slave.format(9, "b")}'
    return parse_config(f"{text}subscribes = [{entries}]\n")


def test_a_gsd_file_that_allows_it(tmp_path: Path) -> None:
    publisher, subscriber = by_gsd(tmp_path).slaves
    assert publisher.params.publishes
    assert len(subscriber.params.links) == 1
    assert publisher.description is not None
    dxb = publisher.description.dxb
    assert dxb is not None
    assert (dxb.publisher, dxb.links, dxb.octets) == (True, 2, 3)


@pytest.mark.parametrize(
    ("old", "new", "problem"),
    [
        ("Publisher_supp = 1", "", "slave a: it publishes, but its GSD file does not say Publisher_supp = 1;"),
        ("Publisher_supp = 1", "Publisher_supp = 0", "does not say Publisher_supp = 1"),
        ("Subscriber_supp = 1", "", "slave b: it subscribes, but its GSD file does not say Subscriber_supp = 1;"),
        ("Prm_Block_Structure_supp = 1", "", "slave b: it subscribes, but its GSD file does not say Prm_Block"),
    ],
)
def test_a_gsd_file_that_does_not(tmp_path: Path, old: str, new: str, problem: str) -> None:
    with pytest.raises(ConfigError) as error:
        by_gsd(tmp_path, old, new)
    assert problem in str(error.value)


def test_an_older_gsd_file(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"Publisher_supp = 1 \(GSD_Revision 4; the keyword came with 5\)"):
        by_gsd(tmp_path, "Publisher_supp = 1", "GSD_Revision = 4")


@pytest.mark.parametrize(
    ("entries", "problem"),
    [
        (", ".join(f'{{ from = "a", octets = "0:1", to = {to} }}' for to in range(3)), "DXB_Max_Link_Count = 2"),
        ('{ from = "a", octets = "0:4", to = 0 }', "DXB_Max_Data_Length = 3"),
    ],
)
def test_limits_of_the_gsd_file(tmp_path: Path, entries: str, problem: str) -> None:
    with pytest.raises(ConfigError, match=problem):
        by_gsd(tmp_path, entries=entries)
