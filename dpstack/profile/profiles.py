"""The drives that are installed."""

from __future__ import annotations

from dpstack.profile import DriveProfile, registry


def known_drives() -> dict[str, DriveProfile]:
    """Every drive by its name, from the entry points ``dpstack.drives``."""
    return registry.known()
