"""LS ELECTRIC LSLV-S100 with CPDP-S100, ``ls-s100``: PROFIdrive, LS Drive profile or plain words."""

from __future__ import annotations

from typing import Final

from dpstack.profile import DriveProfile, OptionSpec
from dpstack_drives.ls import table as t
from dpstack_drives.ls import telegrams
from dpstack_drives.ls.plugin import LsCore
from dpstack_drives.ls.simulator import LsDevice

#: what plugin and drive must agree on
_COMMON: Final = {
    "profile": OptionSpec(
        default="profidrive", choices=("profidrive", "ls"), text="COM-11 in PPO1 to PPO6: PROFIdrive or LS Drive"
    ),
    "speed_unit": OptionSpec(
        default="percent", choices=("percent", "rpm"), text="COM-14: per cent of dr-20 or rpm, PROFIdrive only"
    ),
    "reference_hz": OptionSpec(default=60.0, low=40, high=400, text="what 100 % is: dr-20, maximum frequency"),
    "reference_rpm": OptionSpec(default=1800.0, low=1, high=32767, text="what 100 % is in rpm"),
    "para_status": OptionSpec(default="", text="addresses of COM-31.., e.g. '000A 000E In-90'"),
    "para_control": OptionSpec(default="", text="addresses of COM-51.., e.g. '0005 0006'"),
    "swap": OptionSpec(default=False, text="COM-68: the octets of every word are swapped"),
}


DRIVE: Final = DriveProfile(
    name="ls-s100",
    title="LS ELECTRIC LSLV-S100, CPDP-S100",
    ident=t.IDENT,
    telegrams=telegrams.TELEGRAMS,
    default_telegram=telegrams.DEFAULT,
    family=telegrams.FAMILY,
    user_prm=bytes.fromhex("80 00 00"),
    baud_rates=t.BAUD_RATES,
    reference_hz=60.0,
    gsd="dpstack_drives.ls:ls-s100.gsd",
    on_loss=(
        "by PRT-12 and PRT-13 of the inverter (as delivered it goes on with its last command); Clear does not stop "
        "PROFIdrive: zeros are ignored (STW1 bit 10), so the safe outputs ramp it down before"
    ),
    core_factory=LsCore,
    device_factory=LsDevice,
    details="dpstack_drives.ls.description:describe",
    core_options={
        **_COMMON,
        "trip_word": OptionSpec(
            default="raw",
            choices=("raw", "number"),
            text="what 000F holds: bits (only shown), or the number of a trip",
        ),
    },
    simulated_options={"trip_word": "number"},
    device_options={
        **_COMMON,
        "version": OptionSpec(default="3.00", choices=("3.00", "2.01"), text="of the module; 2.01 has only VENDOR"),
        "quick_stop_s": OptionSpec(default=0.5, low=0, high=600, text="ramp of OFF3 (made up)"),
        "load": OptionSpec(default=0.2, low=0, high=2, text="load torque of the rated one"),
    },
    ready=t.FIELD_BUS,
    notes=(
        "the manual has no GSD file: identifier octets and user parameters are made up, use the user's",
        "the bus runs it with dr-06 = 4 and dr-07 = 8 (field bus), which stand in the inverter's manual",
        "0005, 000A, 0381 and 0015 are not to be used beside a drive profile; as delivered the maps have two of them",
    ),
)
