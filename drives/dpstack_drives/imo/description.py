"""The HD2's part of the commissioning sheet that depends on its options: the maps to write, and the names of faults."""

from __future__ import annotations

from collections.abc import Iterator

from msgspec import structs

from dpstack.profile import DescribedMessage, DescribedStep, DeviceDescription, Options
from dpstack_drives.imo import table as t
from dpstack_drives.imo.plugin import ImoCore


def describe(core: ImoCore, described: DeviceDescription, address: int, options: Options) -> DeviceDescription:
    """The drive of ``core``. Its maps are those of the options, which ``write_map`` writes: the drive's own are read
    over the bus."""
    at = len(described.steps) - 2
    return structs.replace(
        described,
        steps=(*described.steps[:at], *_steps(core), *described.steps[at:]),
        faults=tuple(
            DescribedMessage(code=str(code), text=name, source="the option fault_names")
            for code, name in t.faults(str(options["fault_names"])).items()
        ),
    )


def _steps(core: ImoCore) -> Iterator[DescribedStep]:
    ways = zip(("read", "written"), core.file.maps or (), core.present_maps(), strict=True)
    for what, way, own in reversed(tuple(ways)):
        for key, field in zip(way.codes.places, own.fields, strict=True):
            if field is not None:
                yield DescribedStep(
                    what=f"{key.name} = {field.key} ({field.name})",
                    why=f"the word that is {what} for {field.name}; the plugin reads the map from the drive, "
                    "`write_map` writes this one",
                    delivered="0",
                    source=way.source,
                )
