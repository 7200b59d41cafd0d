"""What commands share that are the master themselves: `run`; `drive` and `acyclic` where no run holds the port."""

from __future__ import annotations

from dpstack.api.config.config import Config
from dpstack.cli.terminal.lost_stdout import warn


def tell_simulated(config: Config) -> None:
    """On the port "virtual" nobody else is: say that the slaves are simulated for this one command."""
    if config.virtual:
        warn(
            'no run holds the port "virtual": its slaves are simulated for this command only; '
            "`dpstack run` with this configuration keeps them, and is asked then"
        )


def refuse_application_watchdog(config: Config, command: str) -> None:
    """Raises ConfigError where ``config`` has an application watchdog: ``command`` never calls ``alive()``."""
    if config.bus.application_watchdog_ms:
        raise config.source.error(
            ("bus", "application_watchdog_ms"),
            "[bus]: application_watchdog_ms is for a program that calls bus.alive(), "
            f"which `dpstack {command}` does not",
            "leave it out of this file, or set it to 0",
        )
