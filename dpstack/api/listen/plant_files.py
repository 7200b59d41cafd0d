"""Files that a monitor needs: devices from a configuration and from a folder of GSD files, thresholds from TOML."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path

from dpstack.api.config.config import Config
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.files import read_file
from dpstack.api.gsd_info import gsd_files, read_gsd
from dpstack.errors import ConfigError, GsdError
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.model import Device
from dpstack.monitor.devices import Devices, KnownDevice
from dpstack.monitor.thresholds import Thresholds, limits
from dpstack.toml.reading import TomlError, read_toml
from dpstack.toml.table import Key, Source, Table
from dpstack.units import BAUD_RATES

#: octets of a file with thresholds
_MOST = 100_000


def load_devices(
    config: Config | None, gsd_folder: str | Path | None, on_skipped: Callable[[str], None] = lambda text: None
) -> Devices:
    """The slaves and S7-200 CPUs of ``config``, and the devices of all GSD files in ``gsd_folder`` and its folders.

    ``on_skipped`` gets one line for each GSD file that cannot be used. Raises ConfigError for a folder without any.
    """
    by_address: dict[int, KnownDevice] = {}
    if config is not None:
        by_address = {slave.address: _configured(slave) for slave in config.slaves}
        by_address |= {cpu.address: KnownDevice(cpu.name) for cpu in config.ppi}
    by_ident: dict[int, KnownDevice] = {}
    if gsd_folder is not None:
        for path in gsd_files(Path(gsd_folder)):
            try:
                device = read_gsd(path).device
            except (ConfigError, GsdError) as error:
                on_skipped(f"skipped: {error}")
                continue
            if device.ident is None:
                on_skipped(f"skipped: {path}: it has no Ident_Number")
            else:
                by_ident.setdefault(device.ident, _described(device))
    return Devices(by_address, by_ident, {} if config is None else _t_sl(config))


def _configured(slave: SlaveConfig) -> KnownDevice:
    device, params = slave.device, slave.params
    model = "" if device is None else _model(device)
    if slave.any_profile is not None:
        model = model or slave.any_profile.title
    dpv1 = slave.gsd_dpv1.slave or params.dpv1 is not None if device is not None or params.dpv1 is not None else None
    return KnownDevice(params.name, model, params.max_tsdr, params.texts, dpv1)


def _described(device: Device) -> KnownDevice:
    max_tsdr = {speed.baud: speed.max_tsdr for speed in device.speeds if speed.max_tsdr is not None}
    return KnownDevice("", _model(device), max_tsdr, DiagTexts(device), device.dpv1.slave)


def _model(device: Device) -> str:
    return " ".join(filter(None, (device.vendor, device.model)))


def _t_sl(config: Config) -> dict[int, int]:
    """T_SL by baud rate; rates that do not fit the configuration are left out."""
    found = {}
    for baud in BAUD_RATES:
        with contextlib.suppress(ConfigError):
            found[baud] = config.params(baud).t_sl
    return found


def load_thresholds(path: str | Path) -> Thresholds:
    """The thresholds of a TOML file; those that it does not name keep their defaults.

    Raises ConfigError with file, line and what to do, for an unknown key with the nearest known one.
    """
    try:
        text = read_file(path, _MOST).decode()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise ConfigError(f"{path}: {why}; give a TOML file with thresholds, see docs/how-to/monitor.md") from None
    try:
        values, lines = read_toml(text)
    except TomlError as error:
        raise ConfigError(f"{path}:{error.line}: {error.what}; correct the file") from None
    table = Table(Source(str(path), lines), (), values, "thresholds")
    return Thresholds(**table.read(_keys()))


def _keys() -> Mapping[str, Key]:
    return {limit.name: Key(limit.low, limit.high, kind=float) for limit in limits()}
