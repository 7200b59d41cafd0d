"""Facts of the Demag that are no data of its device file, and those of it that are looked at by name."""

from __future__ import annotations

from pathlib import Path
from typing import Final

from dpstack.devices.finding import drive_file_at
from dpstack.profile import TelegramSpec, Word

FILE: Final = drive_file_at(Path(__file__).with_name("demag-dedrive.toml"))
TABLE: Final = FILE.table
CONTROL, STATUS = TABLE.control, TABLE.status
PKW: Final = FILE.channel.of_pkw
FAULTS: Final = {code: one.text for code, one in FILE.fault.facts.items()}
WARNINGS: Final = tuple(FILE.warning.texts.values())


def scan_ms(telegram: TelegramSpec) -> int:
    """The internal scan time (10): 16 ms with PPO3, 32 ms with the others."""
    return 16 if telegram.name == "PPO3" else 32


#: 11.2.3, what PZD2 reports by bits 12-14 of the words in PPO1 and PPO3
SELECT_FREQUENCY, SELECT_CURRENT, SELECT_ACTIVE, SELECT_WARNING, SELECT_FAULT = 0, 1, 2, 5, 6
SELECTABLE: Final = frozenset({SELECT_CURRENT, SELECT_ACTIVE, SELECT_WARNING, SELECT_FAULT})
SETS: Final = 4
#: IND of data set n for RAM only is n + 5 (11.1.4)
RAM_ONLY: Final = 5
#: 11.2.1.3, the control word of control by remote contacts; S7 and S8 are reserved
CONTACTS: Final = Word(
    CONTROL.name,
    {f"s{number}": number - 1 for number in range(1, 9)}
    | {name: bit for name, bit in CONTROL.bits.items() if bit >= 8},
)
#: fault acknowledgement is locked for this long (11.2.1), in s
FAULT_LOCK_S: Final = 15
#: warnings that lead to a trip soon, ZSW bit 15: motor temperature, heat sink, inside, Ixt, mains (which is a reading)
TRIPS_SOON: Final = 0x019F
FAULT_MODULE, FAULT_MASTER_LOST, FAULT_CONFIGURATION, FAULT_TOGGLE = FAULTS
