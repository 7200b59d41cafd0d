"""Fuji FRENIC-Multi with OPC-E1-PDP, ``fuji-frenic``: PROFIdrive V2 state machine."""

from __future__ import annotations

from typing import Final

from dpstack.profile import DriveProfile, OptionSpec, TelegramSetting
from dpstack_drives.fuji import table as t
from dpstack_drives.fuji.plugin import FujiCore
from dpstack_drives.fuji.simulator import OWN_SUPPLY, FujiDevice

DRIVE: Final = DriveProfile(
    name="fuji-frenic",
    title="Fuji FRENIC-Multi, OPC-E1-PDP",
    ident=t.IDENT,
    ident_made_up=True,
    telegrams=t.TELEGRAMS,
    default_telegram="PPO1",
    baud_rates=t.BAUD_RATES,
    reference_hz=60.0,
    on_loss=(
        "by o27 and o28; at the factory it coasts and trips Er5 as soon as its watchdog ends data exchange; "
        "Clear does not stop it: zeros are ignored (CTW bit 10), so the safe outputs 047E ramp it down before"
    ),
    core_factory=FujiCore,
    device_factory=FujiDevice,
    details="dpstack_drives.fuji.description:describe",
    core_options={
        "reference_hz": OptionSpec(default=60.0, low=1, high=1000, text="what 100 % is: F03 (60 Hz in the manual)"),
        "reverse": OptionSpec(
            default="sign", choices=("sign", "bit"), text="reverse by a negative MRV or by bit 11 of CTW"
        ),
        "map_inputs": OptionSpec(default="", text="what o48 to o51 of PPO2 and PPO4 are, e.g. 'M16 F26'"),
        "map_outputs": OptionSpec(default="", text="what o40 to o43 of PPO2 and PPO4 are, e.g. 'S06 - F07'"),
    },
    device_options={
        "load": OptionSpec(default=0.2, low=0, high=2, text="load torque of the rated one"),
        "switches": OptionSpec(
            default=-1.0, low=-1, high=99, text="SW1 and SW2, 00: o31 is the address; -1: as its address asks for"
        ),
        "supply": OptionSpec(
            default="inverter", choices=("inverter", OWN_SUPPLY), text="what feeds the option: the inverter or 24 V"
        ),
    },
    ready={"y98": 3},
    telegram_setting=TelegramSetting("o30", t.O30),
    notes=(
        "the manual has no GSD file: ident number and identifier octets are made up, use the user's",
        "y98 is 0 at the factory: only 3 lets the bus run it",
        "o30 chooses the PPO type, from power-on; another configuration is refused",
    ),
)
