"""Names and texts for explained telegrams: of a configuration, of GSD files, and of the plugins of drives.

A slave that is in no configuration is recognised by its ident number: first among the GSD files of the user, then among
those that come with dpstack.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import lru_cache, partial
from pathlib import Path
from typing import Final

from dpstack.api.config.config import Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.gsd_folder import GsdFolder
from dpstack.api.gsd_info import bundled, gsd_files, read_gsd
from dpstack.decode.fields import Fields
from dpstack.decode.names import CpuNames, DriveWords, ModuleName, Names, SlaveNames
from dpstack.devices import finding
from dpstack.dp.pdu.diag_texts import first_slot_of
from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.configuration import modules_of_config
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.identifiers import parse_identifiers
from dpstack.gsd.model import Device, Module
from dpstack.gsd.prm import UserPrm
from dpstack.profile.heard_words import HeardDrive, record_fields
from dpstack.sim import io_station

#: names of slaves that are kept, by ident number and identifier octets
_KEPT: Final = 256


def decode_names(
    config: Config | None = None, gsd: Iterable[str] = (), on_skipped: Callable[[str], None] = lambda text: None
) -> Names:
    """Names of the slaves and S7-200 CPUs in ``config``, and of others by the GSD files ``gsd`` (files, or folders
    of them).

    ``on_skipped`` gets one line for each file of a folder that cannot be used. Raises ConfigError if a file that is
    named cannot be read, and for a folder without GSD files.
    """
    slaves = {} if config is None else {slave.address: _configured(slave) for slave in config.slaves}
    cpus = {} if config is None else {cpu.address: CpuNames(cpu.name, cpu.values) for cpu in config.ppi}
    return Names(slaves, _Recogniser(_GsdFiles(gsd, on_skipped)).names, _record, cpus)


def _configured(slave: SlaveConfig) -> SlaveNames:
    params = slave.params
    texts = params.texts
    modules: Sequence[Module | None] = () if texts is None else texts.modules
    return SlaveNames(
        name=slave.name,
        source="the configuration",
        ident=None if params.ident_adapts else params.ident,
        inputs=slave.input_fields,
        outputs=slave.output_fields,
        modules=_module_names(modules) or _nameless(params.config),
        first_slot=first_slot_of(texts),
        prm=None if slave.device is None else _user_prm(slave.device, modules),
        texts=texts,
        drive=partial(_configured_drive, slave),
    )


def _configured_drive(slave: SlaveConfig) -> DriveWords | None:
    if slave.profile is None or slave.raw:
        return None
    return HeardDrive(slave.profile, slave.name, slave.telegram, dict(slave.options))


def _module_names(modules: Iterable[Module | None]) -> tuple[ModuleName, ...]:
    return tuple(ModuleName("", b"\0") if one is None else ModuleName(one.name, one.config) for one in modules)


def _nameless(config: bytes) -> tuple[ModuleName, ...]:
    try:
        return tuple(ModuleName("", one.octets) for one in parse_identifiers(config))
    except ConfigError:
        return ()


def _user_prm(device: Device, modules: Sequence[Module | None]) -> UserPrm | None:
    try:
        return UserPrm(device, modules)
    except GsdError:
        return None


class _GsdFiles:
    """The GSD files of the user by ident number; of several with the same number the first. Those of a folder are read
    when they are needed."""

    def __init__(self, gsd: Iterable[str], on_skipped: Callable[[str], None]) -> None:
        self._devices: dict[int, tuple[str, Device]] = {}
        self._folders: list[GsdFolder] = []
        self._on_skipped = on_skipped
        for given in gsd:
            path = Path(given)
            if path.is_dir():
                gsd_files(path)  # which raises if it has none
                folder = GsdFolder(path)
                self._folders.append(folder)
                for name, reason in folder.bad:
                    on_skipped(f"left out: {name}: {reason}")
            else:
                device = read_gsd(path).device
                if device.ident is not None:
                    self._devices.setdefault(device.ident, (path.name, device))

    def find(self, ident: int) -> tuple[str, Device] | None:
        """The device with the ident number, and the name of its file."""
        if ident in self._devices:
            return self._devices[ident]
        for folder in self._folders:
            for entry in folder.with_ident(ident):
                if entry.path is None:
                    continue
                try:
                    return entry.path.name, folder.device(entry.key)
                except ConfigError as error:
                    self._on_skipped(f"left out: {error}")
        return None


class _Recogniser:
    """Slaves by their ident number: in the user's GSD files, then in those that come with dpstack."""

    def __init__(self, files: _GsdFiles) -> None:
        self._files = files
        self._bundled: dict[int, str] | None = None
        self._kept = lru_cache(_KEPT)(self._find)

    def names(self, ident: int, config: bytes) -> SlaveNames | None:
        """Names for an ident number and identifier octets (empty while unknown)."""
        return self._kept(ident, config)

    def _find(self, ident: int, config: bytes) -> SlaveNames | None:
        drive = partial(_drive, ident, config)
        known = self._files.find(ident) or self._bundled_device(ident)
        if known is None:
            return SlaveNames(ident=ident, source="a drive of its ident number", drive=drive) if drive() else None
        source, device = known
        modules = modules_of_config(device, config) or ()
        return SlaveNames(
            source=source,
            ident=ident,
            modules=_module_names(modules),
            first_slot=device.first_slot,
            prm=_user_prm(device, modules) if modules else None,
            texts=DiagTexts(device, modules),
            drive=drive,
        )

    def _bundled_device(self, ident: int) -> tuple[str, Device] | None:
        if self._bundled is None:
            drives = finding.known()
            self._bundled = {drives[name].ident: name for name in bundled() if name in drives}
            self._bundled[io_station.IDENT] = io_station.NAME
        name = self._bundled.get(ident)
        if name is None:
            return None
        try:
            return f"the GSD file of {name} that comes with dpstack", read_gsd(name).device
        except ConfigError:  # a file of that name in this folder, which is no configuration
            return None


def _drive(ident: int, config: bytes) -> DriveWords | None:
    """The drive with this ident number, in the telegram with these identifier octets, as its factory has it."""
    for profile in finding.with_ident(ident):
        telegrams = profile.telegrams_of(config)
        if len(telegrams) == 1:
            try:
                return HeardDrive(profile, profile.name, telegrams[0].name, {})
            except ConfigError:  # a drive that needs options
                return None
    return None


def _record(octets: bytes, request: bool, drive: DriveWords | None) -> Fields:
    return record_fields(octets, request, (lambda number, subindex: "") if drive is None else drive.parameter)
