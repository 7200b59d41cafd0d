"""A hardware export of STEP 7 in the constructs of exported files, and the GSD files of its slaves."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from dpstack.importers.step7_cfg import Export, read_cfg
from dpstack.importers.step7_plant import ImportedPlant, make_plant
from dpstack.importers.step7_slaves import GsdFinder

#: keys that stand in each section and say nothing about the bus
_LAYOUT = ('ASSET_ID "0123456789ABCDEF0123456789ABCDEF"', 'POS_X "0"', 'OBJECT_REMOVEABLE "1"', 'CREATOR ""')


def section(head: str, *lines: str, options: Iterable[str] = ()) -> str:
    """``lines``: of the body; keys are indented as STEP 7 does it."""
    body = [line if line.startswith(("LOCAL_", "SYMBOL", "PARAMETER")) else f"  {line}" for line in (*_LAYOUT, *lines)]
    return "\r\n".join((head, *(f"{option} " for option in options), "BEGIN ", *body, "END ", "", ""))


def address(direction: str, first: int, octets: int, bit: int = 0) -> tuple[str, str]:
    return f"LOCAL_{direction}_ADDRESSES ", f"ADDRESS  {first}, {bit}, {octets}, 0, 2, 0"


HEAD = 'FILEVERSION "3.2"\r\n#STEP7_VERSION V5.6 + SP2\r\n#CREATED "Monday, March 02, 2026   08:15:00"\r\n\r\n'
STATION = section('STATION S7300 , "Mischerei"', 'COMMENT ""')
SUBNET = section(
    'SUBNET PROFIBUS , "PROFIBUS(1)"',
    'PROFIBUS_HSA "126"',
    'PROFIBUS_BAUDRATE "1.5_MBPS"',
    'PROFIBUS_RETRIES "1"',
    'PROFIBUS_GAP "10"',
    'PROFIBUS_TSL "300"',
    'PROFIBUS_TTR "30000"',
)
CPU = section(
    'RACK 0, SLOT 2, SUBSLOT 1, "6ES7 315-2AH14-0AB0" "V3.3", "DP"',
    'PROFIBUSADDRESS "2"',
    'LINKED_SUBNETNAME "PROFIBUS(1)"',
    options=("AUTOCREATED", 'MASTER DPSUBSYSTEM 1, "PROFIBUS(1)", DPADDRESS 2'),
)
SYSTEM = section('DPSUBSYSTEM 1, "PROFIBUS(1): DP-Mastersystem (1)"', 'SUBNET_NAME "PROFIBUS(1)"')
#: a slave with a GSD file: the export has ident number, identifier octets and user parameters
CABINET = (
    section(
        'DPSUBSYSTEM 1, DPADDRESS 10, "VALV5678.GSG", "Hauptschrank"',
        'PNO_IDENT_NO "22136"',
        'WD_ON "1"',
        'GROUP_IDENT "3"',
        'NORMSLAVE_PARAM_DATA "05 00 00 11 22 33 44"',
        'COMMENT "Halle 1"',
        *address("IN", 8189, 0),
    )
    + section('DPSUBSYSTEM 1, DPADDRESS 10, SLOT 1, "coupler", "0"', 'SLAVE_CFG_DATA "01 00 00"')
    + section(
        'DPSUBSYSTEM 1, DPADDRESS 10, SLOT 2, "4AI 0-20mA", "4AE"',
        'SLAVE_CFG_DATA "01 00 53"',
        *address("IN", 284, 8),
        'SYMBOL  I , 0, "Füllstand", "Füllstandsmessung B13"',
        'SYMBOL  I , 2, "H19.N_IST", "Istwert ""H19"" - FU"',
    )
    + section(
        'DPSUBSYSTEM 1, DPADDRESS 10, SLOT 3, "8DI 24V DC", "8DE"',
        'SLAVE_CFG_DATA "01 00 10"',
        *address("IN", 3, 1),
        'SYMBOL  I , 3, "NA_INT", "Not-Aus intern betätigt -3S1"',
        'SYMBOL  I , 4, "NA_EXT", ""',
    )
    + section(
        'DPSUBSYSTEM 1, DPADDRESS 10, SLOT 4, "8DO 24V DC", "8DA"',
        'SLAVE_CFG_DATA "01 00 20"',
        *address("OUT", 5, 1),
        'SYMBOL  O , 0, "H8_EBE", "Förderer H8 ein"',
        'SYMBOL  O , 7, "Horn", "Hupe"',
    )
)
#: a slave of Siemens' own: order numbers and addresses only
RACK_IO = (
    section(
        'DPSUBSYSTEM 1, DPADDRESS 12, "6ES7 153-1AA03-0XB0", "Halle 2"',
        'WD_ON "1"',
        'GROUP_IDENT "0"',
        *address("IN", 8188, 0),
    )
    + section(
        'DPSUBSYSTEM 1, DPADDRESS 12, SLOT 4, "6ES7 321-1BH02-0AA0", "DI16xDC24V"',
        "REDUNDANCY",
        "BEGIN",
        'PARTNER "0"',
        "END",
        *address("IN", 20, 2),
        'SYMBOL  I , 9, "Tor_zu", "Tor ""Nord"" zu"',
    )
    + section(
        'DPSUBSYSTEM 1, DPADDRESS 12, SLOT 5, "6ES7 331-1KF01-0AB0", "AI8x13Bit"',
        *address("IN", 336, 16),
        'SYMBOL  I , 1, "T_Lager", "Temperatur Lager"',
        'SYMBOL  I , 5, "T_Getriebe", "Temperatur Getriebe"',
        "PARAMETER ",
        'AI_TYPE, AI , 0, "VOLTAGE"',
    )
)
#: a slave with an F module
GATE = section('DPSUBSYSTEM 1, DPADDRESS 14, "GATE4321.GSD", "Tor"', 'PNO_IDENT_NO "17185"', 'WD_ON "1"') + section(
    'DPSUBSYSTEM 1, DPADDRESS 14, SLOT 1, "F-DI", "194"',
    'SLAVE_CFG_DATA "03 00 C0 83 85"',
    *address("IN", 60, 6),
    *address("OUT", 60, 4),
    'SYMBOL  I , 0, "Lichtgitter", "frei"',
    "PARAMETER ",
    'F_DEST_ADD, "14"',
    'F_WD_TIME_MS, "150"',
)
PLANT = HEAD + STATION + SUBNET + CPU + SYSTEM + CABINET + RACK_IO + GATE

_GSD = """#Profibus_DP
GSD_Revision = 3
Vendor_Name = "dpstack test"
Model_Name = "{model}"
Revision = "1"
{more}
Ident_Number = {ident}
Protocol_Ident = 0
Station_Type = 0
1.5M_supp = 1
500_supp = 1
MaxTsdr_1.5M = 150
MaxTsdr_500 = 100
Modular_Station = 1
Max_Module = 8
Max_Input_Len = 64
Max_Output_Len = 64
Max_Data_Len = 128
Max_Diag_Data_Len = 32
"""


def _modules(modules: dict[str, str]) -> str:
    return "".join(f'Module = "{name}" {octets}\nEndModule\n' for name, octets in modules.items())


VALVES_GSD = _GSD.format(model="valves", ident="0x5678", more="Max_User_Prm_Data_Len = 5") + (
    "User_Prm_Data_Len = 5\nExt_User_Prm_Data_Const(0) = 0x00, 0x11, 0x22, 0x33, 0x00\n"
    + _modules({"coupler": "0x00", "4AI 0-20mA": "0x53", "8DI 24V DC": "0x10", "8DO 24V DC": "0x20"})
)
RACK_GSD = _GSD.format(model="IM 153", ident="0x801D", more='OrderNumber = "6ES7 153-1AA0?-0XB0"') + _modules(
    {"6ES7 321-1BH02-0AA0 16DI": "0x11", "6ES7 331-1KF01-0AB0 8AI": "0x57", "6ES7 322-1BH01-0AA0 16DO": "0x21"}
)


def gsd_folder(folder: Path) -> Path:
    """A folder with the GSD files of both slaves; the valves' in another language than the export has it."""
    folder.mkdir(exist_ok=True)
    (folder / "valv5678.gse").write_text(VALVES_GSD)
    (folder / "etm_801d.gsd").write_text(RACK_GSD)
    return folder


def export_of(text: str = PLANT, encoding: str = "cp1252") -> Export:
    return read_cfg(text.encode(encoding))


def imported(
    text: str = PLANT, system: int | None = None, finder: GsdFinder | None = None, refused: str = ""
) -> ImportedPlant:
    """``refused``: a text; each configuration with it is refused."""

    def check(toml: str) -> str:
        return f"{refused} is refused" if refused and refused in toml else ""

    return make_plant(export_of(text), system, finder, check, file="plant.cfg")


def remark_texts(plant: ImportedPlant) -> list[str]:
    return [remark.text for remark in plant.remarks]
