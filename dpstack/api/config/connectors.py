"""Tables of the connectors that publish a plant, one for each connector; docs/explanation/bridge.md says what a
connector is."""

from __future__ import annotations

import difflib
from collections.abc import Collection, Mapping
from typing import Annotated, Final, Literal

from msgspec import Struct, structs

from dpstack.errors import UsageError
from dpstack.text import brief
from dpstack.toml.table import Key, Source, Table, keys_of


def read_names(table: Table, name: str, _: Key) -> object:
    """Reader of a list of texts, such as ``allow_commands``."""
    value = table.raw(name)
    if not isinstance(value, list) or not all(isinstance(one, str) for one in value):
        table.fail(
            name, f"{name} = {brief(value)} is no list of texts", 'write for instance ["valves.lamp", "hoist.*"]'
        )
    return tuple(value)


def _file(table: Table, name: str, _: Key) -> object:
    """Reader of the name of a file, relative to the configuration."""
    return str(table.folder / table.text(name))


class ConnectorConfig(Struct, frozen=True, kw_only=True):
    """Base class of the tables."""


class MqttConfig(ConnectorConfig, frozen=True, kw_only=True):
    """The keys of [mqtt], as docs/reference/configuration.md has them.

    url: the broker: `"mqtt://HOST:PORT"`, or with TLS `"mqtts://HOST:PORT"`. Left out: it must be given
    format: `"sparkplug"`: [Sparkplug B](sparkplug.md); `"json"`: [topics with plain JSON](mqtt-json.md)
    group: the Sparkplug group, or with JSON the second level of all topics. Left out: it must be given
    node: the edge node; each program that publishes a bus needs one of its own. Left out: the name of the computer
    primary_host: the Sparkplug host without which nothing is published; not with JSON. Left out: births wait for nobody
    allow_commands: the [orders](bridge.md#orders) that hosts may give: `"valves.lamp"`, `"hoist.start"`, `"hoist.*"`
    command_max_age_s: the greatest difference between the time of an order and the clock of this computer
    interval_ms: the values of a device are published no more often
    store_mb: disk space in MB for [values that cannot be delivered](sparkplug.md#store-and-forward); 0: they are lost
    ca: certificates (PEM) by which that of the broker is judged. Left out: those of the system
    cert: the certificate (PEM) of this program. Left out: none
    key: the key (PEM) of `cert`. Left out: none
    user: the user at the broker. Left out: none
    password_env: the environment variable that has the password. Left out: none
    password_file: the file that has the password in its first line, mode 0600. Left out: none
    keepalive_s: the broker takes this program for gone after one and a half times this time without a message
    discovery: `"homeassistant"`: describe slaves, drives and values to
        [Home Assistant](../how-to/home-assistant.md), which makes devices and entities of them; with `format = "json"`
        only. `"off"`: nothing
    discovery_prefix: the first level of the topics of Home Assistant, as its settings of MQTT have it
    datatypes: `"always"`: each metric of Sparkplug has its [type](sparkplug.md#readers-of-others) in data, too, for
        hosts that do not remember the birth; `"births"`: there alone
    status: publish the [status](segment-status.md) of the segment for `dpstack fleet`; `false` if the broker does
        not permit this program the topic `dpstack/GROUP/NODE/status`
    """

    url: str
    group: str
    format: Literal["sparkplug", "json"] = "sparkplug"
    node: str = ""
    primary_host: str = ""
    allow_commands: Annotated[tuple[str, ...], Key(read=read_names)] = ()
    command_max_age_s: Annotated[float, Key(0.1, 3600, "s")] = 2
    interval_ms: Annotated[int, Key(10, 3_600_000)] = 1000
    store_mb: Annotated[int, Key(0, 10_000)] = 100
    ca: Annotated[str, Key(read=_file)] = ""
    cert: Annotated[str, Key(read=_file)] = ""
    key: Annotated[str, Key(read=_file)] = ""
    user: str = ""
    password_env: str = ""
    password_file: Annotated[str, Key(read=_file)] = ""
    keepalive_s: Annotated[int, Key(1, 3600)] = 10
    discovery: Literal["off", "homeassistant"] = "off"
    discovery_prefix: str = "homeassistant"
    datatypes: Literal["births", "always"] = "births"
    status: bool = True


def read_listen(table: Table, name: str, _: Key) -> object:
    """Reader of an address to listen on: ``HOST:PORT``, ``[::1]:PORT`` or ``PORT``."""
    from dpstack.tcp_address import Listen  # here, as most configurations have no connector

    value = table.raw(name)
    try:
        if not isinstance(value, str):
            raise UsageError(f"{name} = {brief(value)} is no text")
        Listen.parse(value, name)
    except UsageError as error:
        what = str(error).partition("; ")[0]
        table.fail(name, what, 'write "HOST:PORT", "[::1]:PORT" or "PORT", with a port up to 65535')
    return value


class MetricsConfig(ConnectorConfig, frozen=True, kw_only=True):
    """The keys of [metrics].

    listen: address and port of `/metrics`, `/healthz` and `/readyz`, see [metrics.md](metrics.md); without
        a host this computer alone reaches it
    values: `true`: the [process values](metrics.md#process-values) of all slaves, too, with their quality
    most_values: the process values that have metrics; more are left out, and reported
    """

    listen: Annotated[str, Key(read=read_listen)] = "127.0.0.1:9464"
    values: bool = False
    most_values: Annotated[int, Key(1, 10_000)] = 2000


class OpcUaConfig(ConnectorConfig, frozen=True, kw_only=True):
    """The keys of [opcua], as docs/reference/configuration.md has them.

    listen: address and port of the server. Left out: `"127.0.0.1:4840"`, which this computer alone reaches
    name: the name of this server, part of its URI; each server of a computer needs one of its own
    cert: its certificate (DER or PEM). Left out: `opcua/NAME.der` in the state directory, made at the first start
    key: the key (PEM, mode 0600) of `cert`; both or neither. Left out: `opcua/NAME.pem` in the state directory, made at
        the first start
    trust_dir: the directory with the certificates of clients that may connect. Left out: any client, as its user may
    users_file: the [users](opcua.md#users), mode 0600. Left out: no users
    anonymous: `"read"`: a client without a user may read and subscribe; `"no"`: it may not connect
    allow_commands: the [orders](bridge.md#orders) that users may give: `"valves.lamp"`, `"hoist.start"`, `"hoist.*"`
    command_max_age_s: the greatest [age](opcua.md#orders) of an order
    history_s: the age up to which values are kept
    history_values: the values that are kept, of all nodes together
    """

    listen: Annotated[str, Key(read=read_listen)] = "127.0.0.1:4840"
    name: str = "plant"
    cert: Annotated[str, Key(read=_file)] = ""
    key: Annotated[str, Key(read=_file)] = ""
    trust_dir: Annotated[str, Key(read=_file)] = ""
    users_file: Annotated[str, Key(read=_file)] = ""
    anonymous: Literal["no", "read"] = "no"
    allow_commands: Annotated[tuple[str, ...], Key(read=read_names)] = ()
    command_max_age_s: Annotated[float, Key(0.1, 3600, "s")] = 2
    history_s: Annotated[float, Key(0, 86_400, "s")] = 3600
    history_values: Annotated[int, Key(0, 1_000_000)] = 100_000


class EpicsConfig(ConnectorConfig, frozen=True, kw_only=True):
    """The keys of [epics], as docs/reference/configuration.md has them.

    prefix: the begin of all [names](epics.md#names), as it is, for instance `"LAB:DP1:"`; no other program of the
        network may have the same. Left out: it must be given
    listen: address and port of Channel Access, TCP and UDP. Left out: `"127.0.0.1:5064"`, which this computer alone
        reaches
    allow_commands: the [orders](epics.md#orders) that anybody who reaches the port may give: `"valves.lamp"`,
        `"hoist.start"`, `"hoist.*"`
    command_max_age_s: an order that waits for its turn for longer is refused
    beacons: the addresses (`"HOST"` or `"HOST:PORT"`) that get [beacons](epics.md#the-network); a server on this
        computer alone sends them to this computer. Left out: no others
    """

    prefix: str
    listen: Annotated[str, Key(read=read_listen)] = "127.0.0.1:5064"
    allow_commands: Annotated[tuple[str, ...], Key(read=read_names)] = ()
    command_max_age_s: Annotated[float, Key(0.1, 3600, "s")] = 2
    beacons: Annotated[tuple[str, ...], Key(read=read_names)] = ()


#: the class of each table by its name, which is that of its connector
CONNECTORS: Final[dict[str, type[ConnectorConfig]]] = {
    "mqtt": MqttConfig,
    "metrics": MetricsConfig,
    "opcua": OpcUaConfig,
    "epics": EpicsConfig,
}


#: the value of ``on_connector_loss`` with which nothing becomes safe
KEEP: Final = "keep"


def who_may_order(tables: Mapping[str, ConnectorConfig]) -> list[str]:
    """The connectors that may give orders."""
    return [name for name, table in tables.items() if getattr(table, "allow_commands", ())]


def loss_text(names: Collection[str], rule: str) -> str:
    """What happens when the connectors ``names``, which may give orders, are lost. ``rule``: ``on_connector_loss``."""
    what = "stays as it is" if rule == KEEP else "becomes safe: outputs get their safe values, drives stop"
    return (
        f"{', '.join(names)}: when a connector ends by a fault or hangs, all that it has ordered {what} "
        f'(on_connector_loss = "{rule}")'
    )


def read_connector(source: Source, name: str, data: object) -> ConnectorConfig:
    """The table ``name``. Raises ConfigError, also for a name that no connector has."""
    if name not in CONNECTORS:
        known = ["bus", "slave", *CONNECTORS]
        near = difflib.get_close_matches(name.lower(), known, n=1, cutoff=0.5)
        connectors = "".join(f", [{connector}]" for connector in CONNECTORS)
        todo = f"did you mean {near[0]!r}?" if near else f"a configuration has [bus], [[slave]]{connectors}"
        raise source.error((name,), f"unknown table or key {name!r}", todo)
    table = Table(source, (name,), data, f"[{name}]")
    found = table.read(keys_of(CONNECTORS[name]))
    for field in structs.fields(CONNECTORS[name]):
        if field.required and field.name not in found:
            table.fail(None, f"no {field.name}", f"add the key {field.name}")
    return CONNECTORS[name](**found)


def read_connectors(source: Source, tables: Mapping[str, object]) -> dict[str, ConnectorConfig]:
    """The tables of all connectors, by name. Raises ConfigError."""
    return {name: read_connector(source, name, data) for name, data in tables.items()}
