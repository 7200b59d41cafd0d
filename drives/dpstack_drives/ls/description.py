"""The S100's part of the commissioning sheet that depends on its profile: words and range."""

from __future__ import annotations

from msgspec import structs

from dpstack.profile import (
    OTHER_MANUAL,
    DescribedRange,
    DeviceDescription,
    Options,
    described_word,
    speed_range,
    states_of,
)
from dpstack_drives.ls import table as t
from dpstack_drives.ls.plugin import LsCore, profile_of


def describe(core: LsCore, described: DeviceDescription, address: int, options: Options) -> DeviceDescription:
    """The drive of ``core``."""
    kind = profile_of(core.telegram, str(options["profile"]))
    own = kind == t.IO
    control, status = ("0006 operation command", "000E operating status") if own else ("control word", "status word")
    table = core.table
    section = {t.IO: OTHER_MANUAL, t.PROFIDRIVE: "5.1.1, 5.1.2", t.LS_DRIVE: "5.3.1, 5.3.2"}[kind]
    return structs.replace(
        described,
        words=(
            structs.replace(described_word(table.control), name=f"{table.control.name}, {control} ({section})"),
            structs.replace(
                described_word(table.status, states_of(table)), name=f"{table.status.name}, {status} ({section})"
            ),
        ),
        ranges=(_range(core, kind, rpm=options["speed_unit"] == "rpm"),),
    )


def _range(core: LsCore, kind: int, *, rpm: bool) -> DescribedRange:
    if kind != t.PROFIDRIVE:
        return DescribedRange(
            name="frequencies",
            range="0..655.35 Hz, the direction is in the control and status word",
            wire="0.01 Hz a count",
            source="5.3.3" if kind == t.LS_DRIVE else OTHER_MANUAL,
        )
    if rpm:
        return DescribedRange(
            name="set point, actual speed", range="-32768..32767 rpm", wire="1 rpm a count, signed", source="4.2.14"
        )
    return speed_range(core, "5.1.3", "dr-20, the maximum frequency; set points end there")
