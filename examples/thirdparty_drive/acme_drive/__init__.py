"""The Acme A300 for dpstack, ``acme-a300``: an example of a drive from outside. There is no such drive."""

from __future__ import annotations

from typing import Final

from acme_drive import table as t
from acme_drive.plugin import AcmeCore
from acme_drive.simulator import AcmeDevice
from dpstack.profile import DriveProfile, OptionSpec

DRIVE: Final = DriveProfile(
    name="acme-a300",
    title="Acme A300",
    ident=0xACE3,
    telegrams=t.TELEGRAMS,
    default_telegram="PKW",
    baud_rates=(9_600, 19_200, 93_750, 187_500, 500_000, 1_500_000),
    max_tsdr={9_600: 60, 19_200: 60, 93_750: 60, 187_500: 60, 500_000: 100, 1_500_000: 150},
    reference_hz=50.0,
    on_loss="it takes the power off and coasts; so it does in Clear",
    core_factory=AcmeCore,
    device_factory=AcmeDevice,
    core_options={"reference_hz": OptionSpec(default=50.0, low=1, high=400, text="what 100 % is, parameter 5")},
    device_options={"load": OptionSpec(default=0.2, low=0, high=2, text="load torque of the rated one")},
)
