"""Drive plugins that run in the bus process."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.drive import DrivePlugin
from dpstack.dpv1.master.plugin_queue import RecordQueue
from dpstack.drivers.process.plugins import PluginRef
from dpstack.errors import ConfigError
from dpstack.profile import DriveCore, DriveStatus, registry

if TYPE_CHECKING:
    from dpstack.drivers.process.client import ProcessRuntime


def core_of(slave: SlaveConfig, *, simulated: bool = False) -> DriveCore | None:
    """The drive plugin of ``slave``; None for a slave without one, or whose outputs the application sets as octets.

    ``simulated``: the slave is simulated in this process.
    """
    if slave.profile is None or slave.raw:
        return None
    records = None if slave.params.dpv1 is None else RecordQueue()
    return slave.profile.core(slave.name, slave.telegram, slave.options, simulated=simulated, records=records)


def plugin_of(slave: SlaveConfig) -> PluginRef | None:
    """The plugin of ``slave`` by name. Raises ConfigError for one that has no entry point to import."""
    if slave.profile is None or slave.raw:
        return None
    place = registry.places().get(slave.profile.name)
    if place is None:
        raise ConfigError(
            f"slave {slave.address} ({slave.name}): its drive plugin {slave.profile.name!r} is an object of this "
            f"program, and the bus process is handed names only; give it an entry point of the group {registry.GROUP}, "
            'or take driver = "asyncio"'
        )
    return PluginRef(
        place=place,
        name=slave.name,
        telegram=slave.telegram,
        options=dict(slave.options),
        records=slave.params.dpv1 is not None,
    )


def remote_plugin(runtime: ProcessRuntime, slave: SlaveConfig) -> DrivePlugin:
    """The drive plugin of ``slave`` in the bus process. A copy in this process knows ranges and references."""
    core = core_of(slave)
    assert core is not None

    def status() -> DriveStatus:
        from dpstack.drivers.process.messages import typed

        told = runtime.drive_status(slave.address)
        return core.status() if told is None else typed(told, DriveStatus)

    return DrivePlugin(core, status)


async def attach_remote(runtime: ProcessRuntime, slave: SlaveConfig) -> DrivePlugin | None:
    """Attach the drive plugin of ``slave`` in the running bus process; None for a slave without plugin.

    Raises ConfigError where it cannot be imported there.
    """
    plugin = plugin_of(slave)
    if plugin is None:
        return None
    from dpstack.drivers.process.messages import AttachPlugin

    await runtime.order(AttachPlugin(slave.address, plugin))
    return remote_plugin(runtime, slave)
