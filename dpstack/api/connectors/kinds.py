"""The connectors that there are, by the name of their table: module, package of the extra, and maker of each.

A connector is loaded only if a table asks for it. The steps of a further one stand in docs/development/architecture.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from platform import python_version
from socket import gethostname
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from dpstack.api.config.connectors import EpicsConfig, MetricsConfig, MqttConfig, OpcUaConfig
from dpstack.bridge.connector import Connector, ConnectorState, Tell, product_version
from dpstack.bridge.names import SPARKPLUG_ID
from dpstack.bridge.orders import Orders
from dpstack.errors import ConfigError
from dpstack.plant.nodes import Described
from dpstack.plant.tree import PlantTree

if TYPE_CHECKING:
    from dpstack.bridge.epics.names import PvNames


class Parts(NamedTuple):
    """The parts of the gateway that a connector is made with. ``orders``: makes the gate of its orders, from its
    ``allow_commands`` and ``command_max_age_s``; raises ConfigError for a name that fits no order of the plant.
    ``slaves``: the slaves of the configuration, as the tree will have them, by address. ``connectors``: the state of
    each connector; ``bus_pid``: the process id of the bus process, None without one."""

    tree: PlantTree
    tell: Tell
    orders: Callable[[Sequence[str], float], Orders]
    slaves: Mapping[int, Described]
    connectors: Callable[[], Sequence[ConnectorState]]
    bus_pid: Callable[[], int | None]


class ConnectorKind(NamedTuple):
    """``module``: loaded before ``make`` is called, which takes the table of the connector and its parts. ``needs``:
    the packages of its extra, which has the name of the connector. ``room_mb``: MB of addresses that its packages and
    threads take."""

    module: str
    needs: tuple[str, ...]
    make: Callable[[Any, Parts], Connector]
    room_mb: int = 0


def _mqtt(config: MqttConfig, parts: Parts) -> Connector:
    from dpstack.bridge.mqtt.broker import Broker, read_password, state_folder
    from dpstack.bridge.mqtt.client import MqttConnector
    from dpstack.bridge.mqtt.edge_node import EdgeNode
    from dpstack.bridge.mqtt.json_node import JsonNode
    from dpstack.bridge.mqtt.plant_node import NodeSetup, PlantNode

    if config.format == "json" and config.primary_host:
        raise ConfigError('primary_host: plain JSON knows none; take it out, or write format = "sparkplug"')
    if config.format == "json" and config.datatypes == "always":
        raise ConfigError('datatypes: plain JSON has none; take it out, or write format = "sparkplug"')
    if config.format != "json" and config.discovery != "off":
        raise ConfigError(
            f'discovery = "{config.discovery}": Home Assistant does not read Sparkplug; write format = "json", too'
        )
    broker = Broker(
        url=config.url,
        ca=Path(config.ca) if config.ca else None,
        cert=Path(config.cert) if config.cert else None,
        key=Path(config.key) if config.key else None,
        user=config.user,
        password=read_password(config.password_env, Path(config.password_file) if config.password_file else None),
        keepalive_s=config.keepalive_s,
    )
    node = config.node or SPARKPLUG_ID.valid(gethostname())
    setup = NodeSetup(
        config.group,
        node,
        config.primary_host,
        config.interval_ms / 1000,
        has_types=config.datatypes == "always",
        discovery_prefix=config.discovery_prefix if config.discovery != "off" else "",
    )
    orders = parts.orders(config.allow_commands, config.command_max_age_s)  # without any: it reports those that come
    folder = state_folder(config.group, node)
    versions = {"dpstack": product_version(), "python": python_version()} if config.status else None
    make_node: type[PlantNode] = JsonNode if config.format == "json" else EdgeNode
    return MqttConnector(
        parts.tree,
        parts.tell,
        broker=broker,
        setup=setup,
        folder=folder,
        orders=orders,
        make_node=make_node,
        store_mb=0 if config.format == "json" else config.store_mb,
        versions=versions,
    )


def _metrics(config: MetricsConfig, parts: Parts) -> Connector:
    from dpstack.bridge.metrics.connector import MetricsConnector  # these here, as most programs have no metrics
    from dpstack.tcp_address import Listen

    listen = Listen.parse(config.listen, "[metrics] listen")
    most_values = config.most_values if config.values else None
    return MetricsConnector(
        parts.tree, parts.tell, listen, connectors=parts.connectors, bus_pid=parts.bus_pid, most_values=most_values
    )


def _opcua(config: OpcUaConfig, parts: Parts) -> Connector:
    from dpstack.bridge.opcua.certificate import state_file
    from dpstack.bridge.opcua.connector import OpcUaConnector, OpcUaSettings

    # else the missing one would be looked for, or made, in the state directory
    if bool(config.cert) != bool(config.key):
        raise ConfigError("cert and key go together; give both, or neither: then both are made at the first start")
    settings = OpcUaSettings(
        config.listen,
        config.name,
        Path(config.cert) if config.cert else state_file(f"{config.name}.der"),
        Path(config.key) if config.key else state_file(f"{config.name}.pem"),
        Path(config.trust_dir) if config.trust_dir else None,
        Path(config.users_file) if config.users_file else None,
        config.anonymous == "read",
        config.history_s,
        config.history_values,
        state_file(f"{config.name}.lock"),
    )
    return OpcUaConnector(
        parts.tree, parts.tell, settings, parts.orders(config.allow_commands, config.command_max_age_s)
    )


def epics_names(config: EpicsConfig, slaves: Mapping[int, Described], *, fixed: bool = True) -> PvNames:
    """The process variables that ``config`` gives a plant with ``slaves``. ``fixed``: its bus has a fixed cycle.
    Raises ConfigError for an invalid name."""
    from dpstack.bridge.epics.names import check_lengths, check_prefix, pvs_of
    from dpstack.bridge.orders import is_allowed
    from dpstack.plant.items import PlanPlant, Plant
    from dpstack.plant.nodes import bus_of

    check_prefix(config.prefix)
    bus = bus_of(Plant(slaves={}, plan=PlanPlant(cycle_us=1 if fixed else None))).nodes
    found = pvs_of(config.prefix, bus, slaves, lambda order: is_allowed(config.allow_commands, order.name))
    check_lengths(found)
    return found


def _epics(config: EpicsConfig, parts: Parts) -> Connector:
    from dpstack.bridge.epics.connector import EpicsConnector  # these here, as most programs have no EPICS
    from dpstack.bridge.epics.server import beacon_address
    from dpstack.tcp_address import Listen

    epics_names(config, parts.slaves)
    return EpicsConnector(
        parts.tree,
        parts.tell,
        Listen.parse(config.listen, "[epics] listen"),
        config.prefix,
        parts.orders(config.allow_commands, config.command_max_age_s),
        beacons=[beacon_address(one) for one in config.beacons],
    )


KINDS: Final[dict[str, ConnectorKind]] = {
    "mqtt": ConnectorKind("dpstack.bridge.mqtt.client", ("aiomqtt", "google.protobuf"), _mqtt, 60),
    "metrics": ConnectorKind("dpstack.bridge.metrics.connector", ("prometheus_client",), _metrics, 20),
    "opcua": ConnectorKind("dpstack.bridge.opcua.connector", ("asyncua", "cryptography"), _opcua, 130),
    "epics": ConnectorKind("dpstack.bridge.epics.connector", ("caproto",), _epics, 10),
}
