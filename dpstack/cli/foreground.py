"""What ``drive`` and ``acyclic`` share where no run holds the port, and they are the master themselves."""

from __future__ import annotations

from dpstack.api.config import Config
from dpstack.cli.streams import warn


def tell_simulated(config: Config) -> None:
    """On the port "virtual" nobody else is: say that the slaves are simulated for this one command."""
    if config.virtual:
        warn(
            'no run holds the port "virtual": its slaves are simulated for this command only; '
            "`dpstack run` with this configuration keeps them, and is asked then"
        )
