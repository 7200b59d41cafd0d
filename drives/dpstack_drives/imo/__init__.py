"""IMO HD2 with its HD2-E-PDP card, ``imo-hd2``: codes instead of command bits, process data chosen by P15."""

from __future__ import annotations

from typing import Final

from dpstack.profile import DriveProfile, OptionSpec
from dpstack_drives.imo import simulator
from dpstack_drives.imo import table as t
from dpstack_drives.imo.plugin import ImoCore

_RATE: Final = OptionSpec(
    default=float(t.RATE_FACTORY), low=0, high=10, text="the card's baud rate by its number, 6: 1.5 Mbit/s"
)

DRIVE: Final = DriveProfile(
    name="imo-hd2",
    title="IMO HD2, HD2-E-PDP card",
    ident=t.IDENT,
    ident_made_up=True,
    telegrams={t.TELEGRAM.name: t.TELEGRAM},
    default_telegram=t.TELEGRAM.name,
    baud_rates=tuple(t.RATE_SETTING.rates.values()),
    rate_setting=t.RATE_SETTING,
    reference_hz=50.0,
    on_loss=(
        "not in the card's manual: reckon with an inverter that runs on; Clear does not stop it: zeros are no command, "
        "so the safe outputs 0005 (stop) ramp it down before"
    ),
    core_factory=ImoCore,
    device_factory=simulator.ImoDevice,
    details="dpstack_drives.imo.description:describe",
    core_options={
        "reference_hz": OptionSpec(default=50.0, low=1, high=600, text="what 100 % is in Hz"),
        "max_hz": OptionSpec(
            default=0.0, low=0, high=655.35, text="the inverter's maximum frequency; 0: as reference_hz"
        ),
        "reference_rpm": OptionSpec(default=0.0, low=0, high=65_535, text="what 100 % is in rpm; 0: not known"),
        "rated_current": OptionSpec(default=0.0, low=0, high=6553.5, text="of the motor in A; 0: not known"),
        "motor": OptionSpec(default="1", choices=("1", "2"), text="motor group, CW bits 9-10"),
        "heartbeat": OptionSpec(default=False, text="set CW bit 15 and warn where SW bit 15 does not follow"),
        "set_map": OptionSpec(default=False, text="start() may write map_outputs and map_inputs to P15, in its EEPROM"),
        "map_outputs": OptionSpec(default="set_frequency", text="what write_map writes to P15.02 to P15.12"),
        "map_inputs": OptionSpec(
            default="frequency current torque fault_code", text="what write_map writes to P15.13 to P15.23"
        ),
        "fault_names": OptionSpec(default="", text="fault codes of the inverter's manual, '4=OC1 11=OL1'"),
        "baud_index": _RATE,
        "frequency_source": OptionSpec(
            default=t.FREQUENCY_SOURCE,
            text="the inverter's parameter for the source of its frequency and the value for PROFIBUS; '': unchecked",
        ),
        "maximum_parameter": OptionSpec(
            default=t.MAXIMUM_HZ, text="the inverter's parameter for the maximum frequency, in 0.01 Hz; '': unchecked"
        ),
    },
    device_options={
        "load": OptionSpec(default=0.2, low=0, high=2, text="load torque of the rated one"),
        "rated_current": OptionSpec(default=10.0, low=0.1, high=6553.5, text="of the motor in A (made up)"),
        "on_loss": OptionSpec(
            default=simulator.GO_ON,
            choices=(simulator.GO_ON, simulator.STOP, simulator.COAST, simulator.TRIP),
            text="what the inverter does without its master",
        ),
        "protected": OptionSpec(default=False, text="a password protects the parameters"),
        "baud_index": _RATE,
    },
    simulated_options={"rated_current": 10.0, "reference_rpm": 1500.0, "fault_names": t.FAULTS_MADE_UP},
    ready={t.SOURCE: int(t.Source.COMMUNICATION), t.FREQUENCY_CHANNEL: t.FROM_PROFIBUS},
    notes=(
        "the manual has no GSD file: ident number and identifier octets are made up, use the user's",
        "P15.02 to P15.23 are 0 at the factory: without a set frequency among them it cannot run (write_map)",
        "it hears only the baud rate its card is set to (option baud_index)",
    ),
)
