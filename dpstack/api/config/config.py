"""``Config``: configuration files, read and checked; every error is one line with file and line number.

:func:`load_config` reads a file, :func:`parse_config` a text, :func:`slave_config` one slave given in a program. All
raise :class:`~dpstack.errors.ConfigError`. What a drive implies (ident, identifier octets, user parameters, MaxTsdr)
comes from the drive registry.
"""

from __future__ import annotations

import contextlib
import dataclasses
import itertools
import os
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

from msgspec import structs

from dpstack.api.config.bus import BusConfig, read_bus
from dpstack.api.config.slave import SlaveConfig, read_slave
from dpstack.api.files import read_file
from dpstack.dp.slave_params import SlaveParams
from dpstack.drivers.line.echo import Echo
from dpstack.errors import ConfigError, ParamError
from dpstack.params import BusParams
from dpstack.ports.base import VIRTUAL
from dpstack.text import octets_text
from dpstack.toml.reading import MAX_OCTETS, TomlError, read_toml
from dpstack.toml.reading import Path as KeyPath
from dpstack.toml.table import Source, Table
from dpstack.units import AUTO, baud_text

if TYPE_CHECKING:
    from dpstack.api.config.connectors import ConnectorConfig
    from dpstack.api.config.cpu import CpuConfig
    from dpstack.ports import Port

#: keys of [bus] that are bus parameters
_PARAMETERS: Final = ("t_sl", "t_tr", "gap", "hsa", "max_retry", "address")
#: drives on one bus beside slaves with several: the status of each has room in the memory shared with a bus process
_MOST_DRIVES: Final = 126
#: the key ``echo`` as the drivers want it
ECHO: Final = {None: Echo.AUTO, True: Echo.ON, False: Echo.OFF}


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """A whole configuration. ``source`` is its name and its lines in messages."""

    #: table [bus]: port, rate, address and bus parameters
    bus: BusConfig
    #: tables [[slave]], in the order of the file
    slaves: tuple[SlaveConfig, ...]
    #: name of the file or of the arguments, and its lines, for messages
    source: Source = field(repr=False, compare=False)
    #: S7-200 CPUs whose values the master reads over PPI
    ppi: tuple[CpuConfig, ...] = ()
    #: the tables of the connectors that publish the plant, by name
    connectors: Mapping[str, ConnectorConfig] = field(default_factory=dict)

    def with_bus(self, **changes: object) -> Config:
        """A copy with other bus settings, checked again; None leaves a setting as it is."""
        given = {key: value for key, value in changes.items() if value is not None}
        if not given:
            return self
        bus = read_bus(Source("argument"), structs.asdict(self.bus) | given)
        return _checked(dataclasses.replace(self, bus=bus))

    def find(self, name: str) -> SlaveConfig | None:
        """The slave with this name, or at this address as text."""
        return next((slave for slave in self.slaves if name in (slave.name, str(slave.address))), None)

    def only(self, slave: SlaveConfig) -> Config:
        """A copy with this ``slave`` only, for a command that needs no other: a master that starts the others, too,
        would set their outputs to the safe values.
        """
        return dataclasses.replace(self, slaves=(slave,), ppi=())

    def with_outputs(self, outputs: Mapping[int, bytes]) -> Config:
        """A copy with initial output octets by slave address; a drive with such outputs runs without its plugin."""
        by_address = {slave.address: slave for slave in self.slaves}
        for address, octets in outputs.items():
            slave = by_address.get(address)
            if slave is None:
                known = ", ".join(map(str, sorted(by_address))) or "none"
                raise ConfigError(f"outputs for address {address}: no slave has it; configured: {known}")
            if len(octets) != slave.params.output_len:
                raise ConfigError(
                    f"outputs for slave {address} ({slave.name}): {octets_text(len(octets))} given; "
                    f"it has {octets_text(slave.params.output_len)} of outputs"
                )
        slaves = tuple(
            structs.replace(s, params=structs.replace(s.params, initial=outputs[s.address]), raw=True)
            if s.address in outputs
            else s
            for s in self.slaves
        )
        return dataclasses.replace(self, slaves=slaves)

    def with_slaves(self, slaves: Iterable[Mapping[str, object] | SlaveConfig]) -> Config:
        """A copy with more slaves."""
        more = _slaves(slaves, "open_bus")
        return _checked(dataclasses.replace(self, slaves=self.slaves + more)) if more else self

    def with_ppi(self, cpus: Iterable[Mapping[str, object] | CpuConfig]) -> Config:
        """A copy with more S7-200 CPUs, mappings with the keys of an entry of ``ppi``."""
        more = cpu_configs(cpus, "open_bus")
        return _checked(dataclasses.replace(self, ppi=self.ppi + more)) if more else self

    @property
    def file(self) -> Path | None:
        """The configuration file, as an absolute path without links; None if it was read from no file."""
        return self.source.file

    @property
    def digest(self) -> str | None:
        """SHA-256 (hex) of the text of the configuration file as it was read; None if it was read from no file."""
        return self.source.digest

    @property
    def port(self) -> str:
        """The port. Raises ConfigError if none exists."""
        if self.bus.port is None:
            raise self.source.error(
                ("bus",), "[bus]: no port", 'add port = "/dev/ttyUSB0" (or "virtual", or socket://host:port)'
            )
        return self.bus.port

    @property
    def baud(self) -> int:
        """The baud rate. Raises ConfigError if none exists, and for "auto"."""
        if self.bus.baud is None:
            raise self.source.error(("bus",), "[bus]: no baud", "add for instance baud = 500000")
        if self.bus.baud == AUTO:
            raise self.source.error(
                ("bus", "baud"),
                '[bus]: baud "auto" is found when the bus is opened',
                "give the rate here, for instance --baud 500000",
            )
        return self.bus.baud

    @property
    def virtual(self) -> bool:
        """True when the slaves are simulated in this process."""
        return self.bus.port == VIRTUAL

    @property
    def slave_params(self) -> tuple[SlaveParams, ...]:
        """The parameters of all slaves."""
        return tuple(slave.params for slave in self.slaves)

    def params(self, baud: int | None = None) -> BusParams:
        """Bus parameters for these slaves at ``baud``; T_TR by the table or by the file. Raises ConfigError."""
        rate = self.baud if baud is None else baud
        tsdr = [slave.max_tsdr[rate] for slave in self.slave_params if rate in slave.max_tsdr]
        given = {key: getattr(self.bus, key) for key in _PARAMETERS}
        try:
            return BusParams.preset(rate, slave_max_tsdr=tsdr, extra_idle=self.bus.extra_idle_bits, **given)
        except ParamError as error:
            path = ("bus", *[key for key in _PARAMETERS if key in str(error)][:1])
            raise self.source.error(path, f"[bus]: {error}", "correct the value or leave it out") from None


def load_config(path: str | Path) -> Config:
    """Read a configuration file. Raises ConfigError, one line, also if the file cannot be read."""
    text = read_text(path, "configuration file")
    return parse_config(text, str(path), file=Path(os.path.realpath(path)))


def _toml_files(folder: Path) -> list[str]:
    """The names of the first thousand files of ``folder`` that end in .toml; none if it cannot be read."""
    with contextlib.suppress(OSError), os.scandir(folder) as entries:
        return sorted(entry.name for entry in itertools.islice(entries, 1000) if entry.name.endswith(".toml"))
    return []


def read_text(path: str | Path, what: str) -> str:
    """The text of a TOML file; ``what``: the kind of file, for messages. Raises ConfigError, one line."""
    name = str(path)
    try:
        return read_file(path, MAX_OCTETS).decode("utf-8-sig")
    except FileNotFoundError:
        import difflib

        near = difflib.get_close_matches(Path(path).name, _toml_files(Path(path).parent), 1)
        if near:
            raise ConfigError(f"{name}: there is no such file; did you mean {Path(path).with_name(near[0])}?") from None
        hint = " (see the README)" if what == "configuration file" else ""
        raise ConfigError(f"{name}: there is no such file; write one{hint} or correct the path") from None
    except IsADirectoryError:
        raise ConfigError(f"{name}: is a directory; name the {what} in it") from None
    except UnicodeDecodeError as error:
        raise ConfigError(f"{name}: is not UTF-8 text (octet {error.start}); save it as UTF-8") from None
    except PermissionError as error:
        raise ConfigError(f"{name}: cannot be read ({error.strerror}); check its permissions") from None
    except (OSError, ValueError) as error:
        raise ConfigError(f"{name}: {getattr(error, 'strerror', None) or error}; give the path of a {what}") from None


def read_tables(text: str, name: str, file: Path | None = None) -> tuple[dict[str, Any], Source]:
    """The values of a TOML ``text``, and the source for messages about them. Raises ConfigError, one line."""
    try:
        data, lines = read_toml(text)
    except TomlError as error:
        place = "" if error.column is None else f" at column {error.column}"
        raise ConfigError.at(name, error.line, f"not valid TOML{place}: {error.what}", "correct that line") from None
    return data, Source(name, lines, file=file, digest=None if file is None else _digest(text))


def file_digest(path: str | Path) -> str | None:
    """The digest of a configuration file as it is now, for a comparison with :attr:`Config.digest`; None if it
    cannot be read."""
    try:
        return _digest(read_text(path, "configuration file"))
    except ConfigError:
        return None


def _digest(text: str) -> str:
    import hashlib  # here, as most programs do not ask for it

    return hashlib.sha256(text.encode()).hexdigest()


def parse_config(text: str, name: str = "config", *, file: Path | None = None) -> Config:
    """Read a configuration from ``text``; ``name``: its name in messages, ``file``: the file that has the text."""
    config, errors = check_config(text, name, file=file)
    if config is None or errors:
        raise errors[0]
    return config


def check_config(
    text: str, name: str = "config", *, file: Path | None = None, most: int = 1
) -> tuple[Config | None, list[ConfigError]]:
    """Read ``text`` as :func:`parse_config`, and collect up to ``most`` errors, at most one of each table.

    The configuration is None if a table cannot be read.
    """
    errors: list[ConfigError] = []
    try:
        data, source = read_tables(text, name, file)
    except ConfigError as error:
        return None, [error]
    bus: BusConfig | None = None
    slaves: list[SlaveConfig] = []
    entries: object = []
    connectors: Mapping[str, ConnectorConfig] = {}
    cpus: tuple[CpuConfig, ...] = ()
    ppi = _take_ppi(data)
    try:
        top = Table(source, (), data, name)
        others = {key: table for key, table in data.items() if key not in ("bus", "slave")}
        if others:
            from dpstack.api.config.connectors import read_connectors  # here, as most configurations have none

            connectors = read_connectors(source, others)
        if "bus" not in top:
            raise source.error((), "no [bus] table", "add [bus] with port and baud")
        bus = read_bus(source, _with_own_address(data["bus"]) if ppi else data["bus"])
        cpus = _cpus(source, ppi)
        entries = data.get("slave", [])
        if not isinstance(entries, list):
            todo = "write two brackets: there may be several slaves"
            raise source.error(("slave",), "[slave] must be [[slave]]", todo)
    except ConfigError as error:
        errors.append(error)
        entries = data.get("slave", [])
    for n, entry in enumerate(entries if isinstance(entries, list) else []):
        if len(errors) >= most:
            return None, errors
        try:
            slaves.append(read_slave(Table(source, ("slave", n), entry, f"[[slave]] {n + 1}")))
        except ConfigError as error:
            errors.append(error)
    if bus is None or errors:
        return None, errors
    config = Config(bus=bus, slaves=tuple(slaves), source=source, ppi=cpus, connectors=connectors)
    errors += [source.error(*conflict) for conflict in itertools.islice(_conflicts(config), most)]
    try:
        return _linked(config), errors
    except ConfigError as error:
        return config, [*errors, error][:most]


def _take_ppi(data: dict[str, Any]) -> list[tuple[KeyPath, object]]:
    """Take the lists ``ppi`` out of ``data``, each with its path. TOML counts a key behind [bus] or [[slave]] to that
    table: the CPUs are stations of the bus wherever the list stands."""
    slaves = data.get("slave")
    tables: list[tuple[KeyPath, object]] = [((), data), (("bus",), data.get("bus"))]
    tables += [(("slave", number), one) for number, one in enumerate(slaves if isinstance(slaves, list) else ())]
    return [((*path, "ppi"), table.pop("ppi")) for path, table in tables if isinstance(table, dict) and "ppi" in table]


def _cpus(source: Source, places: list[tuple[KeyPath, object]], title: str = "[[ppi]]") -> tuple[CpuConfig, ...]:
    """The S7-200 CPUs of the lists ``ppi`` at ``places``. Raises ConfigError."""
    if not places:
        return ()
    from dpstack.api.config.cpu import read_cpus  # here, as most plants have none

    return tuple(read_cpus(source, places, title))


def cpu_configs(cpus: Iterable[Mapping[str, object] | CpuConfig], where: str) -> tuple[CpuConfig, ...]:
    """S7-200 CPUs from mappings with the keys of an entry of ``ppi``. Raises ConfigError."""
    given = tuple(cpus)
    return _cpus(Source(where), [(("ppi",), given)], "ppi") if given else ()


def _with_own_address(bus: object) -> object:
    """The table [bus] of a plant with S7-200 CPUs: they have 2 as delivered, so the master takes 0 by itself."""
    from dpstack.api.config.cpu import OWN_ADDRESS

    return {"address": OWN_ADDRESS, **bus} if isinstance(bus, Mapping) else bus


def make_config(
    port: str,
    baud: int | Literal["auto"],
    address: int = 2,
    slaves: Iterable[Mapping[str, object] | SlaveConfig] = (),
    *,
    where: str = "open_bus",
    bus: Mapping[str, object] | None = None,
) -> Config:
    """A configuration from a program: ``slaves`` with the keys of [[slave]], ``bus`` with further keys of [bus]."""
    source = Source(where)
    table: dict[str, object] = {"port": port, "baud": baud, "address": address, **(bus or {})}
    return _checked(Config(bus=read_bus(source, table, "bus"), slaves=_slaves(slaves, where), source=source))


def _slaves(slaves: Iterable[Mapping[str, object] | SlaveConfig], where: str) -> tuple[SlaveConfig, ...]:
    return tuple(s if isinstance(s, SlaveConfig) else slave_config(s, n, where=where) for n, s in enumerate(slaves))


def slave_config(
    table: Mapping[str, object], number: int = 0, *, where: str = "open_bus", unaddressed: bool = False
) -> SlaveConfig:
    """One slave from a mapping with the keys of a [[slave]] table. ``unaddressed``: 126 is an address too."""
    source = Source(where)
    return read_slave(Table(source, ("slave", number), table, f"slave {number + 1}"), unaddressed=unaddressed)


def _checked(config: Config) -> Config:
    """``config`` with the links between its slaves. Raises ConfigError for the first conflict between its tables."""
    for path, what, todo in _conflicts(config):
        raise config.source.error(path, what, todo)
    return _linked(config)


def _linked(config: Config) -> Config:
    """``config`` with the links of data exchange broadcast. Raises ConfigError."""
    if not any(slave.subscribes for slave in config.slaves):
        return config
    from dpstack.api.config.broadcast import UnlinkedError, linked

    try:
        return dataclasses.replace(config, slaves=linked(config.slaves))
    except UnlinkedError as error:
        path = ("slave", error.number, "subscribes")
        raise config.source.error(path, error.what, error.todo) from None


def _conflicts(config: Config) -> Iterator[tuple[KeyPath, str, str]]:
    """(key, problem, remedy) of addresses and names that are not unique, also that of the master."""
    stations: list[tuple[KeyPath, str, str, int]] = [
        *((("slave", number), "slave", one.name, one.address) for number, one in enumerate(config.slaves)),
        *((one.path, "the CPU", one.name, one.address) for one in config.ppi),
    ]
    at: dict[int, tuple[str, str]] = {}
    names: dict[str, int] = {}
    for path, kind, name, address in stations:
        if address == config.bus.address:
            what = f"{kind} {name} has address {address}, which is the master's own"
            yield (*path, "address"), what, "give one of the two another address ([bus] has the master's)"
        if address in at:
            other_kind, other = at[address]
            what = f"{other_kind} {other} and {kind} {name} both have address {address}"
            todo = "give one of them another address"
            if other_kind == kind != "slave":
                todo = f"write all values of one CPU into one entry, or {todo}"
            yield (*path, "address"), what, todo
        if name in names:
            what = f"the stations at address {names[name]} and {address} are both called {name!r}"
            yield (*path, "name"), what, "give each a name of its own"
        at[address] = kind, name
        names[name] = address
    yield from _conflicts_of_drives(config, names)
    if config.bus.address > config.bus.hsa:
        what = f"[bus]: address {config.bus.address} lies above hsa {config.bus.hsa}"
        yield ("bus", "hsa"), what, "no other master would ever find it: raise hsa or take a lower address"


def _conflicts_of_drives(config: Config, slaves: Mapping[str, int]) -> Iterator[tuple[KeyPath, str, str]]:
    """As :func:`_conflicts`, of the names of drives in slaves with several; ``slaves``: address by name."""
    names: dict[str, int] = {}
    for number, slave in enumerate(config.slaves):
        key = ("slave", number, "drives")
        for drive in slave.drives:
            if drive.name in slaves:
                what = f"a drive of slave {slave.address} and the slave at {slaves[drive.name]} are both {drive.name!r}"
                yield key, what, "give each a name of its own"
            if names.setdefault(drive.name, slave.address) != slave.address:
                what = f"the slaves {names[drive.name]} and {slave.address} both have a drive called {drive.name!r}"
                yield key, what, "give each a name of its own"
    count = len(names) + sum(slave.profile is not None for slave in config.slaves)
    if names and count > _MOST_DRIVES:
        yield ("slave",), f"{count} drives", f"{_MOST_DRIVES} are possible on one bus"


def rate_findings(config: Config, baud: int) -> list[str]:
    """One text for each slave whose manual, GSD file or setting does not support ``baud``."""
    return [
        f"slave {s.address} ({s.name}): {_rate_finding(s, baud)}"
        for s in config.slaves
        if s.baud_rates and baud not in s.baud_rates
    ]


def _rate_finding(slave: SlaveConfig, baud: int) -> str:
    profile = slave.any_profile
    if profile is not None and profile.rate_setting is not None:
        rates = " or ".join(baud_text(rate) for rate in slave.baud_rates)
        option = profile.rate_setting.option
        return (
            f"{profile.name} finds no baud rate by itself and hears only {rates}, not {baud_text(baud)}: set it at the "
            f"drive and give it by the option {option}, or take another rate"
        )
    rates = ", ".join(baud_text(rate) for rate in sorted(slave.baud_rates))
    return f"{profile.name if profile else 'by its GSD file it'} does not know {baud_text(baud)}; it knows {rates}"


def port_of(config: Config, baud: int, name: str | None = None) -> Port:
    """The port of ``config`` (or the port ``name`` with its settings), not open yet. Raises PortError."""
    from dpstack.ports import open_port  # here, as a plant in virtual time has none

    return open_port(name or config.port, baud, event_char=config.bus.event_char, rs485=config.bus.rs485)


__all__ = [
    "AUTO",
    "BusConfig",
    "Config",
    "load_config",
    "make_config",
    "parse_config",
    "rate_findings",
    "slave_config",
]
