"""Demag Dedrive Compact with CM-PDP-24, ``demag-dedrive``: control by state machine (412 = 1) or contacts (2)."""

from __future__ import annotations

from typing import Final

from dpstack.profile import NS_PER_US, DriveProfile, OptionSpec
from dpstack_drives.demag import table as t
from dpstack_drives.demag.plugin import MODES, DemagCore
from dpstack_drives.demag.simulator import OWN_SUPPLY, DemagDevice

DRIVE: Final = DriveProfile(
    name="demag-dedrive",
    title="Demag Dedrive Compact, CM-PDP-24",
    ident=t.IDENT,
    telegrams=t.TELEGRAMS,
    default_telegram="PPO1",
    user_prm=bytes(16),
    baud_rates=tuple(t.MAX_TSDR),
    max_tsdr=t.MAX_TSDR,
    min_slave_interval_ns=100 * NS_PER_US,
    fail_safe=True,
    reference_hz=50.0,
    gsd="dpstack_drives.demag:demag-dedrive.gsd",
    on_loss=(
        "trips F2062 and coasts when its watchdog ends data exchange while it runs; Clear lets it coast, and "
        "where 880 = 1 and it lasts longer than 881 it trips F2100, which is locked for 15 s"
    ),
    core_factory=DemagCore,
    device_factory=DemagDevice,
    details="dpstack_drives.demag.description:describe",
    core_options={
        "reference_hz": OptionSpec(
            default=50.0, low=1, high=1000, text="what 100 % is: 390, or 375 where 390 is 0 (factory 50 Hz)"
        ),
        "map_outputs": OptionSpec(
            default="",
            text="PZD3 to PZD6 of PPO2 and PPO4: reference (PZD3), bool, percent, current, torque, frequency, -",
        ),
        "scaling_current": OptionSpec(
            default=0.0,
            low=0,
            high=10_000,
            text="the drive's scaling current in A, for current, torque; 0: not known",
        ),
        "control": OptionSpec(
            default="state-machine",
            choices=tuple(MODES),
            text="control by the state machine (412 = 1) or by the contacts S1IND to S8IND (412 = 2)",
        ),
        "set_412": OptionSpec(default=False, text="start() may set 412 (control by the bus) itself, in RAM"),
    },
    device_options={
        "f_max": OptionSpec(default=60.0, low=0, high=1000, text="highest frequency in Hz (made up)"),
        "f_min": OptionSpec(default=0.0, low=0, high=1000, text="lowest line set point in Hz with 434 = 2 (made up)"),
        "acceleration": OptionSpec(default=50.0, low=0.01, high=9999.99, text="ramp up in Hz/s (made up)"),
        "deceleration": OptionSpec(default=50.0, low=0.01, high=9999.99, text="ramp down in Hz/s (made up)"),
        "application": OptionSpec(
            default="vf",
            choices=("vf", "speed", "torque"),
            text="kind of configuration: only with vf 392 can be 1 (DC brake), with torque it is 0 at the factory",
        ),
        "load": OptionSpec(default=0.2, low=0, high=2, text="load torque of the rated one"),
        "supply": OptionSpec(
            default="inverter",
            choices=("inverter", OWN_SUPPLY),
            text="what feeds the Profibus module: the inverter or 24 V (manual 4.1)",
        ),
    },
    ready={"412": 1},
    left_open={"412": 44},  # one of two bus modes: the user chooses, and start() can set it (set_412)
    notes=(
        "412 is 44 at the factory: only 1 and 2 let the bus control it; PPO3 and PPO4 cannot set it",
        "a fault can be acknowledged 15 s after it came",
        "inputs change every 32 ms, with PPO3 every 16 ms",
    ),
)
