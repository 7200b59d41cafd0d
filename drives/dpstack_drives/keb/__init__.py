"""KEB COMBIVERT F5 with its PROFIBUS operator, ``keb-f5``: a profile of its own."""

from __future__ import annotations

from typing import Final

from dpstack.profile import NS_PER_US, DriveProfile, OptionSpec
from dpstack_drives.keb import table as t
from dpstack_drives.keb import telegrams
from dpstack_drives.keb.plugin import KebCore
from dpstack_drives.keb.simulator import KebDevice

DRIVE: Final = DriveProfile(
    name="keb-f5",
    title="KEB COMBIVERT F5, PROFIBUS operator",
    ident=t.IDENT,
    ident_made_up=True,
    telegrams=telegrams.TELEGRAMS,
    default_telegram=telegrams.DEFAULT,
    family=telegrams.FAMILY,
    baud_rates=tuple(t.MAX_TSDR),
    max_tsdr=t.MAX_TSDR,
    min_slave_interval_ns=100 * NS_PER_US,
    reference_hz=50.0,
    on_loss=(
        "goes on with its last outputs until the operator's watchdog acts: Pn.06 (time, 0 = never, as delivered) and "
        "Pn.05 (what then; as delivered only a digital output); Clear writes zeros, which end the run command"
    ),
    core_factory=KebCore,
    device_factory=KebDevice,
    details="dpstack_drives.keb.description:describe",
    core_options={
        "control_bits": OptionSpec(
            default="", text="bits of sy.50: enable, run, reset, reverse, quick_stop; 'run=2 ...'"
        ),
        "status_bits": OptionSpec(default="", text="bits of sy.51: run, fault, ready, reached and any other names"),
        "direction": OptionSpec(
            default="bit", choices=("bit", "sign"), text="reverse by its bit (oP.01 = 9) or by sign"
        ),
        "rpm_per_count": OptionSpec(default=0.0, low=0, high=1000, text="the unit of sy.52 and sy.53; 0: not known"),
        "reference_rpm": OptionSpec(default=1500.0, low=1, high=100_000, text="what 100 % is in rpm"),
        "reference_hz": OptionSpec(default=50.0, low=1, high=1600, text="what 100 % is in Hz"),
        "map_inputs": OptionSpec(default="", text="the drive's input map, e.g. '202C:long 2033 2035'"),
        "map_outputs": OptionSpec(default="", text="the drive's output map, e.g. '2032 2034'"),
        "block2_inputs": OptionSpec(default="", text="indexes of record and enable of block 2 of the inputs, in hex"),
        "block2_outputs": OptionSpec(default="", text="indexes of record and enable of block 2 of the outputs, in hex"),
        "pd_in_cycle_ms": OptionSpec(default=25.0, low=0, high=10_000, text="PD_In_Cycle (Fb09) of the drive"),
    },
    device_options={
        "control_bits": OptionSpec(default=t.CONTROL_BITS, text="what the bits of sy.50 do (made up)"),
        "status_bits": OptionSpec(default=t.STATUS_BITS, text="meaning of the bits of sy.51 (made up)"),
        "rpm_per_count": OptionSpec(default=1.0, low=0.001, high=1000, text="the unit of sy.52 and sy.53 (made up)"),
        "reference_rpm": OptionSpec(default=1500.0, low=1, high=100_000, text="rated motor speed"),
        "block2_inputs": OptionSpec(default=t.BLOCK2_INPUTS, text="record and enable of block 2 (made up)"),
        "block2_outputs": OptionSpec(default=t.BLOCK2_OUTPUTS, text="record and enable of block 2 (made up)"),
        "map_acts": OptionSpec(
            default=t.AT_POWER_ON,
            choices=(t.AT_POWER_ON, t.WITH_ENABLE),
            text="a new process data map acts at power-on, or with its enable: the manual says both",
        ),
        "com_cycle_us": OptionSpec(default=0.0, low=0, high=1_000_000, text="SelComCycle, 0: no cyclic mode"),
        "load": OptionSpec(default=0.2, low=0, high=2, text="load torque of the rated one"),
    },
    simulated_options={
        "control_bits": t.SIMULATED_BITS,
        "status_bits": t.SIMULATED_BITS,
        "rpm_per_count": 1.0,
        "block2_inputs": t.BLOCK2_INPUTS,
        "block2_outputs": t.BLOCK2_OUTPUTS,
    },
    ready=t.READY,
    gsd="dpstack_drives.keb:keb-f5.gsd",
    notes=(
        "the ident number is a guess from the name of its GSD file",
        "the bits of sy.50 and sy.51 and the unit of sy.52 are not in its PROFIBUS manual: name them by options",
        f"it obeys the control word with {t.RECIPE}",
        "a new process data map acts after power-on or with its enable (its manual says both)",
        "F5-B, F5-C and R6-S have 8 octets each way, not 16",
    ),
)
