"""Build backend of pyproject.toml: that of setuptools, with a source archive that can be made again octet by octet.

setuptools gives the members of the archive the times, owners and modes of the files of this computer. Where
``SOURCE_DATE_EPOCH`` is set, all members get that time, owner 0 and mode 0644 or 0755, and stand in the order of their
names. A wheel that is built from such an archive has the same modes.
"""

from __future__ import annotations

import gzip
import io
import os
import tarfile
from collections.abc import Mapping
from pathlib import Path

from setuptools import build_meta
from setuptools.build_meta import (
    build_editable,
    build_wheel,
    get_requires_for_build_editable,
    get_requires_for_build_sdist,
    get_requires_for_build_wheel,
    prepare_metadata_for_build_editable,
    prepare_metadata_for_build_wheel,
)

__all__ = [
    "build_editable",
    "build_sdist",
    "build_wheel",
    "get_requires_for_build_editable",
    "get_requires_for_build_sdist",
    "get_requires_for_build_wheel",
    "prepare_metadata_for_build_editable",
    "prepare_metadata_for_build_wheel",
]


def build_sdist(sdist_directory: str, config_settings: Mapping[str, object] | None = None) -> str:
    """The hook of PEP 517."""
    name = str(build_meta.build_sdist(sdist_directory, config_settings))
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch is not None:
        path = Path(sdist_directory) / name
        path.write_bytes(normalised(path.read_bytes(), int(epoch)))
    return name


def normalised(archive: bytes, epoch: int) -> bytes:
    """The archive (.tar.gz) with all that depends on a computer or a moment set to fixed values."""
    made = io.BytesIO()
    with (
        tarfile.open(fileobj=io.BytesIO(archive)) as old,
        gzip.GzipFile(fileobj=made, mode="wb", filename="", mtime=epoch) as packed,
        tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as new,
    ):
        for member in sorted(old.getmembers(), key=lambda one: one.name):
            member.mtime = epoch
            member.mode = 0o755 if member.isdir() or member.mode & 0o100 else 0o644
            member.uid = member.gid = 0
            member.uname = member.gname = ""
            member.pax_headers = {}
            new.addfile(member, old.extractfile(member) if member.isreg() else None)
    return made.getvalue()
