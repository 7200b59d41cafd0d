"""The Fuji FRENIC-Multi as an entry for the registry."""

from __future__ import annotations

from typing import Final

from dpstack.profile import DriveProfile, OptionSpec
from dpstack_drives.fuji import table as t
from dpstack_drives.fuji.plugin import FujiCore
from dpstack_drives.fuji.simulator import FujiDevice

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
    core_options={
        "reference_hz": OptionSpec(default=60.0, low=1, high=1000, text="what 100 % is: F03 (60 Hz in the manual)"),
        "reverse": OptionSpec(
            default="sign", choices=("sign", "bit"), text="reverse by a negative MRV or by bit 11 of CTW"
        ),
    },
    device_options={"load": OptionSpec(default=0.2, low=0, high=2, text="load torque of the rated one")},
    notes=(
        "the manual has no GSD file: ident number and identifier octets are made up, use the user's",
        "y98 is 0 at the factory (the simulated drive: 3): only 3 lets the bus run it",
        "o30 chooses the PPO type, from power-on; another configuration is refused",
    ),
)
