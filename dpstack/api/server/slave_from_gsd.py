"""A slave of one's own from a GSD file and a function."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from dpstack.api.gsd_info import read_gsd
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dp.slave.device import Leave
from dpstack.dpv1.slave.description_from_gsd import slave_description
from dpstack.dpv1.slave.device import OnCycle
from dpstack.dpv1.slave.record_requests import Records
from dpstack.dpv1.slave.record_table import ImOf
from dpstack.dpv1.slave.user_slave import DpSlave, OnAddress, OnIm, OnRead, OnTransport, OnWrite
from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.configuration import configure, default_modules


def slave_from_gsd(
    path: str | Path,
    on_cycle: OnCycle,
    modules: Sequence[int | str] | None = None,
    *,
    name: str = "",
    safe: bytes | None = None,
    on_prm: Callable[[bytes], str | None] | None = None,
    on_blocks: Callable[[tuple[PrmBlock, ...]], str | None] | None = None,
    on_address: OnAddress | None = None,
    on_leave: Callable[[Leave], None] | None = None,
    on_read: OnRead | None = None,
    on_write: OnWrite | None = None,
    on_transport: OnTransport | None = None,
    im: ImOf = (),
    on_im: OnIm | None = None,
    parameters: Records | None = None,
) -> DpSlave:
    """The slave that the GSD file at ``path`` describes, doing what ``on_cycle(outputs, elapsed)`` does.

    ``modules``: names or reference numbers of those that are plugged, in slot order, "" for an empty slot; then this
    configuration only is accepted. None: any that the file allows, and Get_Cfg tells what the file presets, or its
    first module. ``on_cycle`` must give inputs for each of them. The rest as :class:`DpSlave` has it. A bundled drive's
    GSD file is found by the drive's name. Raises ConfigError.
    """
    device = read_gsd(path).device
    try:
        chosen = None if modules is None else configure(device, modules)
        preset = configure(device) if chosen is None and default_modules(device) is not None else None
        description = slave_description(device, chosen, name=name)
    except GsdError as error:
        raise ConfigError(f"{path}: {error}") from None
    return DpSlave(
        description,
        on_cycle,
        config=None if preset is None else preset.config,
        safe=safe,
        on_prm=on_prm,
        on_blocks=on_blocks,
        on_address=on_address,
        on_leave=on_leave,
        on_read=on_read,
        on_write=on_write,
        on_transport=on_transport,
        im=im,
        on_im=on_im,
        parameters=parameters,
    )
