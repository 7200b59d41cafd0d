"""From an export of STEP 7 to a configuration: DP system, bus parameters, the file as text.

The file is for work beside the PLC: it is read only, and its address is one that no station of the export has.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Final

from dpstack.dp.slot_map import Direction
from dpstack.errors import ConfigError
from dpstack.importers.step7_cfg import Export, Remark, Section
from dpstack.importers.step7_layout import Place
from dpstack.importers.step7_slaves import ExportedSlave, GsdFinder, Variant, slave_variants
from dpstack.params import BUS_LIMITS, MAX_STATION, BusParams
from dpstack.text import runs_of, shortened, some_of
from dpstack.toml.reading import comment, table_lines, toml_key, toml_value
from dpstack.units import BAUD_RATES, baud_text

_MASTER: Final = re.compile(
    r'MASTER\s+DPSUBSYSTEM\s+(\d{1,9})\s*,(?:\s*"(.*?)"\s*,)?\s*DPADD?RESS\s+(\d{1,9})', re.ASCII
)
_BAUD: Final = re.compile(r"(\d{1,5}(?:\.\d{1,3})?)[_ ]*([KM])(?:BPS|BIT)", re.IGNORECASE | re.ASCII)
_PROFIBUS: Final = "PROFIBUS"
#: keys of [bus] by the keys of the subnet
_PARAMETERS: Final = {
    "hsa": "PROFIBUS_HSA",
    "t_sl": "PROFIBUS_TSL",
    "t_tr": "PROFIBUS_TTR",
    "gap": "PROFIBUS_GAP",
    "max_retry": "PROFIBUS_RETRIES",
}
#: addresses that programming devices (0), panels (1) and PLCs (2) have as delivered: taken last
_USUAL: Final = (0, 1, 2)
_NUMERIC: Final = re.compile(r"[+-]?(\d+|0[xX][0-9a-fA-F]+)")
#: characters of a name of a slave
_NAME: Final = 60
#: for the check of a single slave
_ANY_BAUD: Final = 500_000
_READ_ONLY: Final = (
    "The PLC is the master of these slaves. read_only: `dpstack run` of this file joins the token ring of the PLC as",
    "one more master, looks and writes nothing. To listen without sending: dpstack monitor --port PORT --config FILE.",
)


@dataclass(slots=True)
class DpSystem:
    """One DP master system of the export. ``name`` as in the export, ``subnet`` of its cable."""

    number: int
    name: str = ""
    subnet: str = ""
    #: the address of the PLC; None if the export does not say it
    master: int | None = None
    slaves: list[ExportedSlave] = field(default_factory=list)

    @property
    def title(self) -> str:
        return f'{self.number} "{self.name or self.subnet}" ({_count(len(self.slaves), "slave")})'


@dataclass(slots=True)
class SlaveText:
    """A slave as it stands in the file: ``source`` for people, ``active`` False: as comments only."""

    address: int
    name: str
    source: str
    names: int
    lines: list[str]
    active: bool = True
    refuse_master: str = ""
    octets_known: bool = True
    #: symbols that have other names in the file
    renamed: list[Place] = field(default_factory=list)


@dataclass(slots=True)
class ImportedPlant:
    """A configuration made from an export. ``text``: the file; ``remarks`` by line of the export."""

    station: str
    version: str
    system: DpSystem
    baud: int | None
    address: int
    text: str
    slaves: list[SlaveText]
    remarks: list[Remark]


def dp_systems(export: Export, remarks: list[Remark]) -> list[DpSystem]:
    """The DP systems of the export by number. A slave with two interfaces (redundancy) stands in both systems."""
    systems: dict[int, DpSystem] = {}
    slaves: dict[tuple[int, int], ExportedSlave] = {}
    for section in export.sections:
        for option in section.options:
            if found := _MASTER.fullmatch(option):
                system = systems.setdefault(int(found[1]), DpSystem(int(found[1])))
                system.subnet, system.master = found[2] or "", int(found[3])
        if section.kind != "DPSUBSYSTEM" or section.place("DPSUBSYSTEM") is None:
            continue
        system = systems.setdefault(section.places["DPSUBSYSTEM"], DpSystem(section.places["DPSUBSYSTEM"]))
        address = section.place("DPADDRESS")
        if address is None:
            system.name = section.text(0)
            system.subnet = section.keys.get("SUBNET_NAME") or system.subnet
        elif section.place("SLOT") is None:
            _add(system, slaves, address, section, remarks)
        elif (slave := slaves.get((system.number, address))) is not None:
            slave.slots.append(section)
        else:
            _add(system, slaves, address, Section("DPSUBSYSTEM", section.line, {**section.places}, []), remarks)
            slaves[system.number, address].head.places.pop("SLOT")
            slaves[system.number, address].slots.append(section)
            remarks.append(Remark(section.line, f"slave {address}: its own section is missing"))
    _add_second_interfaces(systems, remarks)
    return [systems[number] for number in sorted(systems)]


def _add(
    system: DpSystem, slaves: dict[tuple[int, int], ExportedSlave], address: int, head: Section, remarks: list[Remark]
) -> None:
    if (system.number, address) in slaves:
        text = f"slave {address}: it stands twice in DP system {system.number}; the first one counts"
        remarks.append(Remark(head.line, text))
        return
    slave = ExportedSlave(address, head)
    slaves[system.number, address] = slave
    system.slaves.append(slave)


def _add_second_interfaces(systems: Mapping[int, DpSystem], remarks: list[Remark]) -> None:
    by_subnet = {system.subnet: system for system in systems.values() if system.subnet}
    for system in list(systems.values()):
        for slave in list(system.slaves):
            for section in slave.slots:
                other = by_subnet.get(section.keys.get("LINKED_SUBNETNAME", ""))
                given = section.keys.get("PROFIBUSADDRESS", "")
                if other is None or other is system or not (given.isascii() and given.isdigit()):
                    continue
                if any(one.head is slave.head for one in other.slaves):
                    continue
                address = int(given[:4])
                if any(one.address == address for one in other.slaves):
                    text = f"slave {address}: another slave of DP system {other.number} has the address of this"
                    remarks.append(Remark(section.line, f"{text} interface"))
                    continue
                other.slaves.append(ExportedSlave(address, slave.head, slave.slots))


def choose(systems: list[DpSystem], number: int | None) -> DpSystem:
    """The system with ``number``, or the only one with slaves. Raises ConfigError with the numbers there are."""
    listed = "; ".join(system.title for system in systems)
    if not systems:
        raise ConfigError(
            "has no DP master system (DPSUBSYSTEM), so there is no plant in it; export the station whose CPU or CP is "
            "the DP master"
        )
    if number is not None:
        found = next((system for system in systems if system.number == number), None)
        if found is None:
            raise ConfigError(f"has no DP system {number}; it has {listed}")
        return found
    full = [system for system in systems if system.slaves]
    if len(full) > 1:
        raise ConfigError(f"has {len(full)} DP systems, each a cable of its own; choose one by --system: {listed}")
    return full[0] if full else systems[0]


def make_plant(
    export: Export,
    number: int | None,
    finder: GsdFinder | None,
    check: Callable[[str], str],
    *,
    file: str = "export",
) -> ImportedPlant:
    """The configuration of one DP system of ``export``. ``file``: its name for people.

    ``check``: the reason why the text of a configuration is refused, empty if it is accepted. A way to write a slave
    that is refused gives place to the next one; the last one then stands as comments. Raises ConfigError: no or
    several systems, an unknown number.
    """
    remarks = [*export.remarks]
    systems = dp_systems(export, remarks)
    if export.cut and not systems:
        raise ConfigError(
            f"was cut within the section of line {export.cut}, in front of its DP master system; export it again"
        )
    system = choose(systems, number)
    remarks += _left_out(export, systems, system)
    subnet = next((s for s in export.sections if s.kind == "SUBNET" and s.text(0) == system.subnet), None)
    address = _free_address(export, system, subnet)
    bus, baud = _bus(subnet, address, system, check, remarks)
    taken: set[str] = set()
    before = "\n".join(table_lines("[bus]", {"port": "virtual", "baud": _ANY_BAUD, "address": address}))
    slaves = [
        _slave_text(slave, finder, lambda lines: check(f"{before}\n{lines}"), taken, remarks)
        for slave in sorted(system.slaves, key=lambda one: (one.address, one.head.line))
    ]
    if not slaves:
        remarks.append(Remark(0, f"DP system {system.number} has no slaves"))
    remarks += _without_octets(system, {slave.address for slave in slaves if not slave.octets_known}, finder)
    if renamed := sorted((place for slave in slaves for place in slave.renamed), key=lambda one: one.line):
        examples = some_of(dict.fromkeys(repr(one.symbol) for one in renamed))
        text = f"names that a configuration cannot have are changed, the file has both: {examples}"
        remarks.append(Remark(renamed[0].line, text))
    _too_high(slaves, remarks)
    unwatched = [one.address for one in system.slaves if one.head.keys.get("WD_ON") == "0"]
    if unwatched:
        text = f"the PLC uses no watchdog (WD_ON 0) for slaves {_runs(unwatched)}: watchdog_ms is left out here"
        remarks.append(Remark(0, text))
    station = next((section for section in export.sections if section.kind == "STATION"), None)
    name = "" if station is None else station.text(0)
    remarks.sort()
    head = [
        f"Made by dpstack import from {file} ({export.encoding}): station {name}, DP system {system.title}"
        + (f", STEP 7 {export.version}" if export.version else ""),
        *([] if station is None else " ".join(station.keys.get("COMMENT", "").split()).splitlines()),
        *_READ_ONLY,
    ]
    lines = [comment(line) for line in head]
    if remarks:
        lines += ["#", "# Remarks of the import, by line of the export:"]
        lines += [comment(f"  {one.line}: {one.text}" if one.line else f"  {one.text}") for one in remarks]
    lines += ["", *bus]
    for one in slaves:
        lines += ["", *one.lines]
    return ImportedPlant(name, export.version, system, baud, address, "\n".join(lines) + "\n", slaves, remarks)


def _left_out(export: Export, systems: list[DpSystem], chosen: DpSystem) -> Iterator[Remark]:
    central = [s for s in export.sections if s.kind == "RACK" and s.symbols]
    if central:
        count = sum(len(section.symbols) for section in central)
        text = f"{_count(count, 'symbol')} of central modules (RACK), which no bus carries: left out"
        yield Remark(central[0].line, text)
    count = sum(bool(section.parameters) for slave in chosen.slaves for section in slave.slots)
    if count:
        text = f"the parameters (PARAMETER) of {_count(count, 'module')} are left out: STEP 7 sends them in its own way"
        yield Remark(0, text)
    others = [system for system in systems if system is not chosen and system.slaves]
    for system in others:
        yield Remark(0, f"DP system {system.title} is left out: --system {system.number} makes a file of it")
    devices = {s.place("IOADDRESS") for s in export.sections if s.kind == "IOSUBSYSTEM"} - {None}
    if devices:
        yield Remark(0, f"{_count(len(devices), 'device')} of PROFINET (IOSUBSYSTEM), not of PROFIBUS: left out")


def _free_address(export: Export, system: DpSystem, subnet: Section | None) -> int:
    """The lowest address that no station of the export has and that the masters look for; 0 and 1 last."""
    taken = {slave.address for slave in system.slaves} | {system.master}
    for section in export.sections:
        if section.keys.get("LINKED_SUBNETNAME") == system.subnet:
            taken.add(_number(section, "PROFIBUSADDRESS"))
    hsa = None if subnet is None else _number(subnet, "PROFIBUS_HSA")
    highest = min(MAX_STATION, MAX_STATION if hsa is None else hsa)
    possible: list[int] = [*range(len(_USUAL), highest + 1), *reversed(_USUAL)]
    for address in possible:
        if address not in taken:
            return address
    raise ConfigError("each address of the bus has a station; none is left for dpstack")


def _number(section: Section, key: str) -> int | None:
    text = section.keys.get(key, "")
    return int(text) if text.isascii() and text.isdigit() and len(text) < 10 else None


def _bus(
    subnet: Section | None, address: int, system: DpSystem, check: Callable[[str], str], remarks: list[Remark]
) -> tuple[list[str], int | None]:
    """The lines of [bus], and the baud rate."""
    found = {} if subnet is None else {key: _number(subnet, said) for key, said in _PARAMETERS.items()}
    parameters = {key: value for key, value in found.items() if value is not None}
    for key, value in list(parameters.items()):
        low, high, _ = BUS_LIMITS[key]
        if not low <= value <= high:
            remarks.append(Remark(subnet.line if subnet else 0, f"{_PARAMETERS[key]} {value} is outside {low}..{high}"))
            del parameters[key]
    baud = _baud(subnet, parameters, remarks)
    plc = "an unknown address" if system.master is None else f"address {system.master}"
    known: dict[str, object] = {"baud": baud, "address": address, "read_only": True}
    why = {"address": f"a station that the export does not have; the PLC has {plc}"}
    if baud is not None and parameters:
        refused = check("\n".join(table_lines("[bus]", {"port": "virtual", **known, **parameters})))
        if refused:
            remarks.append(Remark(subnet.line if subnet else 0, f"its bus parameters are left out: {refused}"))
            parameters = {}
    lines = table_lines("[bus]", {**known, **parameters}, why)
    about = "" if subnet is None else " ".join(subnet.keys.get("COMMENT", "").split())
    if about:
        lines.insert(1, comment(about))
    lines.insert(1, '# port = "/dev/ttyUSB0"  # or --port')
    if baud is None:
        lines.insert(2, "# baud = 1500000  # not in the export")
    return lines, baud


def _baud(subnet: Section | None, parameters: Mapping[str, int], remarks: list[Remark]) -> int | None:
    """The rate of the subnet: by its key, else by T_SL, which the profiles of STEP 7 derive from it."""
    line = 0 if subnet is None else subnet.line
    said = "" if subnet is None else subnet.keys.get("PROFIBUS_BAUDRATE", "")
    if found := _BAUD.fullmatch(said):
        rate = round(float(found[1]) * {"K": 1_000, "M": 1_000_000}[found[2].upper()])
        near = next((known for known in BAUD_RATES if abs(known - rate) < known / 1000), None)
        if near is not None:
            return near
    if said:
        remarks.append(Remark(line, f"PROFIBUS_BAUDRATE {shortened(said)} is no rate of PROFIBUS: give baud by hand"))
        return None
    fitting = [rate for rate in BAUD_RATES if BusParams.preset(rate).t_sl == parameters.get("t_sl")]
    if len(fitting) == 1:
        text = f"no PROFIBUS_BAUDRATE; PROFIBUS_TSL {parameters['t_sl']} is that of {baud_text(fitting[0])}"
        remarks.append(Remark(line, f"{text}: check it with dpstack baud"))
        return fitting[0]
    remarks.append(
        Remark(
            line,
            "the baud rate is not in the export: export subnets and default values, too, or find it with dpstack baud",
        )
    )
    return None


def _slave_text(
    slave: ExportedSlave,
    finder: GsdFinder | None,
    check: Callable[[str], str],
    taken: set[str],
    remarks: list[Remark],
) -> SlaveText:
    name = _slave_name(slave, taken, remarks)
    variants, common = slave_variants(slave, finder)
    remarks += common
    refused = f"stations have the addresses 0..{MAX_STATION}" if slave.address > MAX_STATION else ""
    for variant in variants:
        lines = _table(slave, name, variant)
        if slave.address > MAX_STATION:
            break
        refused = check("\n".join(lines))
        if not refused:
            break
        text = f"slave {slave.address} ({name}), {variant.source}: refused: {refused}"
        remarks.append(Remark(slave.head.line, text))
    remarks += variant.remarks
    reason = str(variant.keys.get("refuse_master") or "")
    if variant.f_modules and not refused:
        text = f"slave {slave.address} ({name}): for listening and simulation only: {variant.f_modules}"
        remarks.append(Remark(slave.head.line, text))
    if refused:
        lines = [f"# slave {slave.address} stands as comments: {comment(refused)[2:]}", *(f"# {one}" for one in lines)]
    return SlaveText(
        slave.address,
        name,
        variant.source,
        len(variant.places),
        lines,
        not refused,
        reason,
        variant.octets_known,
        [place for place in variant.places if place.symbol != place.name],
    )


def _table(slave: ExportedSlave, name: str, variant: Variant) -> list[str]:
    keys = {"name": name, "address": slave.address, **variant.keys}
    lines = table_lines("[[slave]]", keys, {"address": variant.source})
    about = " ".join(slave.head.keys.get("COMMENT", "").split())
    if about:
        lines.append(comment(about))
    lines += [comment(line) for line in variant.slots]
    for direction in Direction:
        own = [place for place in variant.places if place.direction is direction]
        if own:
            lines.append(f"[slave.{direction}s]")
            lines += [
                f"{toml_key(place.name)} = {toml_value(place.spec)}"
                + (f"  {comment(place.remark)}" if place.remark else "")
                for place in own
            ]
    return lines


def _slave_name(slave: ExportedSlave, taken: set[str], remarks: list[Remark]) -> str:
    given = " ".join(slave.head.text(1).split())[:_NAME]
    name = "".join(letter if letter.isprintable() else "_" for letter in given)
    if not name or _NUMERIC.fullmatch(name):
        name = f"slave{slave.address}"
    if name in taken:
        name = f"{name}-{slave.address}"
        text = f"slave {slave.address}: another slave is called {given!r}, too; this one is {name!r} here"
        remarks.append(Remark(slave.head.line, text))
    taken.add(name)
    return name


def _without_octets(system: DpSystem, addresses: set[int], finder: GsdFinder | None) -> Iterator[Remark]:
    """A remark for each order number (or GSD file) whose slaves have no identifier octets."""
    heads: dict[str, list[ExportedSlave]] = {}
    for slave in system.slaves:
        if slave.address in addresses:
            heads.setdefault(slave.head.text(0), []).append(slave)
    what = "no GSD file of the folder fits" if finder is not None else "give their GSD file (--gsd)"
    for title, slaves in heads.items():
        text = (
            f"slave{'s' * (len(slaves) > 1)} {_runs(slave.address for slave in slaves)} ({title}): ident number and "
            f"identifier octets are not in the export: listening shows the names, a simulation takes any of the right "
            f"lengths; {what}"
        )
        yield Remark(min(slave.head.line for slave in slaves), text)


def _too_high(slaves: Iterable[SlaveText], remarks: list[Remark]) -> None:
    high = [text.address for text in slaves if text.address > MAX_STATION]
    if high:
        text = f"{len(high)} slaves have addresses above {MAX_STATION} ({_runs(high)}), which PROFIBUS does not have"
        remarks.append(Remark(0, f"{text}: they stand as comments"))


def _runs(numbers: Iterable[int]) -> str:
    return some_of((str(a) if a == b else f"{a} to {b}" for a, b in runs_of(numbers)), 5)


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"
