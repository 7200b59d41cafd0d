"""The user's own slave from a GSD file and a function (:func:`slave_from_gsd`)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Unpack

from dpstack.api.gsd_info import read_gsd
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.dpv1.slave.device import OnCycle
from dpstack.dpv1.slave.user_slave import DpSlave, SlaveOptions
from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.configuration import configure, default_modules


def slave_from_gsd(
    path: str | Path,
    on_cycle: OnCycle,
    modules: Sequence[int | str] | None = None,
    *,
    name: str = "",
    **options: Unpack[SlaveOptions],
) -> DpSlave:
    """The slave that the GSD file at ``path`` describes, doing what ``on_cycle(outputs, elapsed)`` does.

    ``modules``: names or reference numbers of those that are plugged, in slot order, "" for an empty slot; then it
    accepts only this configuration. None: any that the file allows, and Get_Cfg returns ``config``, the file's preset,
    or its first module. ``on_cycle`` must give inputs for each of them. ``options`` are those of :class:`DpSlave`. A
    bundled drive's GSD file is found by the drive's name. Raises ConfigError.
    """
    device = read_gsd(path).device
    try:
        chosen = None if modules is None else configure(device, modules)
        preset = configure(device) if chosen is None and default_modules(device) is not None else None
        description = slave_description(device, chosen, name=name)
    except GsdError as error:
        raise ConfigError(f"{path}: {error}") from None
    if preset is not None and options.get("config") is None:
        options["config"] = preset.config
    return DpSlave(description, on_cycle, **options)
