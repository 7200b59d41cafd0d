"""A configuration file, from its octets to the checked configuration; each error is one plain line."""

from __future__ import annotations

from typing import Final

from dpstack.api.config.config import Config, check_config, parse_config, rate_findings
from dpstack.errors import ConfigError
from tests.fuzz.frame import Target, assert_plain, parsed, words


def run(octets: bytes) -> None:
    """The octets are a file."""
    text = octets.decode("utf-8", "replace")
    config, errors = check_config(text, "fuzz.toml", most=4)
    for error in errors:
        assert_plain(str(error))
        assert "\n" not in str(error)
    again = parsed(lambda _: parse_config(text), b"", ConfigError)
    assert (again is None) == bool(errors or config is None)
    if config is not None and not errors:
        parsed(lambda _: _use(config), b"", ConfigError)


def _use(config: Config) -> None:
    """Everything that a bus asks of its configuration before it opens a port."""
    for slave in config.slaves:
        assert config.find(slave.name) is not None
        assert slave.params.input_len <= 244
        assert slave.params.output_len <= 244
    params = config.params(500_000)
    assert params.t_sl > 0
    rate_findings(config, 500_000)
    assert config.with_bus(baud=config.bus.baud) == config


#: a file that every input begins with, mostly
_BEGIN: Final = b'[bus]\nport="virtual"\nbaud=500000\n'


def repair(octets: bytes) -> bytes:
    """Let the file begin with a bus."""
    return octets if octets.startswith(b"[bus]\n") else _BEGIN + octets


TARGET = Target(
    run,
    covers=("dpstack.api.config", "dpstack.dp.process_data", "dpstack.dp.slave_params", "dpstack.params"),
    max_len=220,
    repair=repair,
    words=words("config"),
    slow_s=2.0,
)
