"""Drives by name or path: plugins of packages, and device files in folders.

A name is looked for among the entry points of plugins, in the folders of the environment variable ``DPSTACK_DEVICES``,
in the user's data folder, among the files that packages bring (entry points of the group ``dpstack.device_files``) and
among those that come with dpstack. The first one found counts.
"""

from __future__ import annotations

import functools
import importlib.util
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from pkgutil import resolve_name
from typing import Final

from dpstack.devices.model import DeviceFile, EncoderFile, FileFacts
from dpstack.entry_points import entry_points
from dpstack.errors import ConfigError
from dpstack.profile import registry
from dpstack.profile.drive_profile import DeviceProfile, DriveProfile

#: the bases of drives
DRIVE_BASES: Final = ("profidrive", "drivecom", "bits")
#: entry points of packages that bring device files: the name of a device, and the package with ``NAME.toml`` in it
GROUP: Final = "dpstack.device_files"
ENDING: Final = ".toml"
_HERE: Final = Path(__file__).parent
#: PA devices have a room above this one: how a file is read, and its profile
_PA_READER: Final = "dpstack.devices.pa.reader:PaReader"
_PA_PROFILE: Final = "dpstack.devices.pa.profile:profile_of_pa"
#: files that are looked at in a folder
_MOST_FILES: Final = 1000


def is_path(name: str) -> bool:
    """Whether ``name`` is the path of a device file and no name."""
    return name.endswith(ENDING) or "/" in name or os.sep in name


def find(name: str, folder: Path | None = None) -> DriveProfile:
    """The drive called ``name``, or that of the device file at this path (relative to ``folder``).

    Raises ConfigError with the nearest names, or with the mistakes of the file.
    """
    if is_path(name):
        return _drive(Path(folder or ".", name))
    if name in registry.places() or registry.is_given(name):
        return registry.find(name)
    path = path_of(name)
    if path is not None:
        return _drive(path)
    import difflib  # here, as most names are right

    names = [*registry.places(), *files()]
    near = difflib.get_close_matches(name.lower(), names, n=3)
    if near:
        raise ConfigError(f"no drive is called {name!r}; did you mean {' or '.join(near)}?")
    raise ConfigError(
        f"no drive is called {name!r}; known: {', '.join(sorted(names)) or 'none (is dpstack installed?)'}"
    )


def gsd_of(name: str) -> str | None:
    """The ``gsd`` of the profile of the drive called ``name``; None if it brings no GSD file. No other is loaded."""
    if path_of(name) is None and name not in registry.places() and not registry.is_given(name):
        return None
    try:
        return find(name).gsd
    except ConfigError:
        return None


def find_device(name: str, folder: Path | None = None) -> DeviceProfile:
    """The device that is no drive, as :func:`find`. Raises ConfigError."""
    path = Path(folder or ".", name) if is_path(name) else path_of(name)
    if path is None:
        if name in registry.places() or registry.is_given(name):
            raise ConfigError(f"{name!r} is a drive; write drive = {name!r}")
        known = ", ".join(known_devices()) or "none"
        raise ConfigError(f"no device is called {name!r}; known: {known}; or give the path of a device file")
    found = _profile(path)
    if not isinstance(found, DriveProfile):
        return found
    raise ConfigError(f"{name!r} is a drive; write drive = {name!r}")


def profile_at(place: str) -> DriveProfile | DeviceProfile:
    """The drive or device of the device file ``path``, if its digest is still the given one: ``DIGEST PATH``, for a bus
    process.

    Raises ConfigError.
    """
    digest, _, path = place.partition(" ")
    profile = _profile(Path(path))
    if file_at(Path(path)).digest != digest:
        raise ConfigError(f"{path} has changed while the bus was opened; open it again")
    return profile


def known() -> dict[str, DriveProfile]:
    """All drives by name; those that cannot be loaded are left out, see :func:`broken`."""
    found = {name: one for name, one in _in_files().items() if isinstance(one, DriveProfile)}
    return dict(sorted((found | registry.known()).items()))


def known_devices() -> dict[str, DeviceProfile]:
    """All devices that are no drives, by name, as :func:`known`."""
    return {name: one for name, one in sorted(_in_files().items()) if not isinstance(one, DriveProfile)}


def _in_files() -> dict[str, DriveProfile | DeviceProfile]:
    found = {}
    for name, path in files().items():
        try:
            found[name] = _profile(path)
        except ConfigError:
            continue
    return found


def with_ident(ident: int) -> list[DriveProfile]:
    """The drives with this ident number, by name."""
    return [one for one in known().values() if ident and one.ident == ident]


def broken() -> dict[str, str]:
    """Plugins and device files that cannot be loaded: name -> why."""
    found = {}
    for name, path in files().items():
        try:
            _profile(path)
        except ConfigError as error:
            found[name] = str(error)
    return found | registry.broken()


def files() -> dict[str, Path]:
    """Device files by name, in the folders and of packages; the first one of a name counts."""
    found: dict[str, Path] = {}
    for folder in folders():
        for path in _listed(folder):
            found.setdefault(path.stem, path)
    for name, package in _of_packages().items():
        if (brought := _in_package(name, package)) is not None:
            found.setdefault(name, brought)
    for folder in (_HERE / "library", _HERE / "bases"):
        for path in _listed(folder):
            if path.stem not in _NO_DRIVES:
                found.setdefault(path.stem, path)
    return found


def origins() -> dict[str, str]:
    """The package with its version, or the folder, that brings each drive: ``dpstack 1.0``. No plugin is imported."""
    from importlib import metadata

    found = {}
    points = {point.name: point for point in metadata.entry_points(group=GROUP)}
    for name, path in files().items():
        point = points.get(name)
        dist = None if point is None else point.dist
        if path.is_relative_to(_HERE):
            found[name] = f"dpstack {metadata.version('dpstack')}"
        elif point is not None and path == _in_package(name, point.value):
            found[name] = "" if dist is None else f"{dist.name} {dist.version}"
        else:
            found[name] = str(path.parent)
    return found | registry.origins()


#: bases that are no drive without a file
_NO_DRIVES: Final = frozenset({"drivecom", "bits", "encoder"})


def path_of(name: str) -> Path | None:
    """The device file called ``name``; None if no folder has it."""
    if name != Path(name).name or name.startswith("."):
        return None
    for folder in folders():
        if (path := folder / (name + ENDING)).is_file():
            return path
    package = _of_packages().get(name)
    if package is not None and (found := _in_package(name, package)) is not None:
        return found
    for folder in (_HERE / "library", _HERE / "bases"):
        if (path := folder / (name + ENDING)).is_file() and name not in _NO_DRIVES:
            return path
    return None


def base_of(name: str, beside: Path) -> Path:
    """The file of a base called ``name`` in the file ``beside``. Raises ConfigError."""
    own = _HERE / "bases" / (name + ENDING)
    if name == Path(name).name and own.is_file():
        return own
    found = beside.parent / name if is_path(name) else path_of(name)
    if found is None or not found.is_file():
        bases = sorted(path.stem for path in (_HERE / "bases").glob("*" + ENDING))
        raise ConfigError.at(
            str(beside),
            None,
            f"base = {name!r}: there is no such file",
            f"it must be {', '.join(bases)} or a device file",
        )
    return found


def folders() -> list[Path]:
    """The folders of the user: those of ``DPSTACK_DEVICES``, then the data folder."""
    given = [Path(one) for one in os.environ.get("DPSTACK_DEVICES", "").split(os.pathsep) if one]
    data = os.environ.get("XDG_DATA_HOME") or os.path.join(os.path.expanduser("~"), ".local", "share")
    return [*given, Path(data, "dpstack", "devices")]


def file_at(path: Path) -> FileFacts:
    """The device file at ``path``, read again when it or its time has changed. Raises ConfigError."""
    return _read(*_key(path))


def drive_file_at(path: Path) -> DeviceFile:
    """As :func:`file_at`, the file of a drive, for the Python behind it."""
    from dpstack.devices.model import DeviceFile

    found = file_at(path)
    assert isinstance(found, DeviceFile)
    return found


def read(path: Path) -> FileFacts:
    """The device file at ``path``. Raises DeviceFileError with all mistakes, or ConfigError."""
    from dpstack.devices.reader import ENCODER, PA, Reader

    reader = Reader(path, base_of)
    if reader.root == ENCODER:
        from dpstack.devices.encoder_reader import EncoderReader

        return EncoderReader(path, base_of).read()
    if reader.root == PA:
        of_pa: type[Reader] = resolve_name(_PA_READER)
        return of_pa(path, base_of).read()
    return reader.read()


def _drive(path: Path) -> DriveProfile:
    found = _profile(path)
    if isinstance(found, DriveProfile):
        return found
    raise ConfigError(f"{path.name} describes no drive; write device = ... in place of drive = ...")


def _profile(path: Path) -> DriveProfile | DeviceProfile:
    return _made(*_key(path))


@functools.lru_cache(maxsize=256)
def _made(path: Path, changed_at: int, size: int) -> DriveProfile | DeviceProfile:
    return made(_read(path, changed_at, size))


def made(file: FileFacts) -> DriveProfile | DeviceProfile:
    """The profile of a device file. Raises ConfigError."""
    if isinstance(file, DeviceFile):
        from dpstack.devices.profiles import profile_of

        return profile_of(file)
    if isinstance(file, EncoderFile):
        from dpstack.devices.encoder import profile_of_encoder

        return profile_of_encoder(file)
    profile_of_pa: Callable[[FileFacts], DeviceProfile] = resolve_name(_PA_PROFILE)
    return profile_of_pa(file)


def _key(path: Path) -> tuple[Path, int, int]:
    """The file and its state. Raises ConfigError if it cannot be read."""
    try:
        stamp = path.stat()
    except (OSError, ValueError) as error:
        why = getattr(error, "strerror", None) or error
        raise ConfigError(f"the device file {path} cannot be read ({why}); give its path") from None
    return path.resolve(), stamp.st_mtime_ns, stamp.st_size


@functools.lru_cache(maxsize=256)
def _read(path: Path, _changed_at: int, _size: int) -> FileFacts:
    return read(path)


def _listed(folder: Path) -> Iterator[Path]:
    try:
        entries = sorted(folder.glob("*" + ENDING))[:_MOST_FILES]
    except OSError:
        return
    yield from (path for path in entries if path.is_file())


@functools.cache
def _of_packages() -> dict[str, str]:
    """The packages with device files by the name of the device; none is imported for it."""
    return {point.name: point.value for point in sorted(entry_points(GROUP), key=lambda one: one.name)}


def _in_package(name: str, package: str) -> Path | None:
    try:
        spec = importlib.util.find_spec(package)
    except (ImportError, ValueError):
        return None
    for folder in () if spec is None else spec.submodule_search_locations or ():
        if (path := Path(folder, name + ENDING)).is_file():
            return path
    return None
