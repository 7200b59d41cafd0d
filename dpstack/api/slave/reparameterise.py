"""What can be changed of a slave while the bus runs, read and checked as its [[slave]] table is."""

from __future__ import annotations

import dataclasses

from dpstack.api.config.slave import Changes, SlaveConfig, changed_params
from dpstack.api.config.table import Source, Table, keys_of
from dpstack.errors import ConfigError, UsageError


def changed(slave: SlaveConfig, changes: Changes) -> SlaveConfig:
    """``slave`` after ``changes``, held against its names for process data and its GSD file.

    Raises UsageError for a change there is not, ConfigError.
    """
    keys = keys_of(Changes)
    unknown = sorted(set(changes) - set(keys))
    if unknown:
        raise UsageError(f"{unknown[0]!r} cannot be changed; these can: {', '.join(sorted(keys))}")
    where = f"slave {slave.address} ({slave.name})"
    table = Table(Source(where), (), changes, "reparameterise")
    params = dataclasses.replace(slave.params, **changed_params(slave, table, table.read(keys)))
    if slave.profile is not None and not slave.raw and (slave.params.dpv1 is None) is not (params.dpv1 is None):
        raise UsageError(
            f"{where}: DP-V1 on or off decides how its drive plugin asks for parameters: remove the slave and add it "
            f"with another dpv1"
        )
    described = slave.description
    reason = None
    if described is not None and params.config in described.configs:
        reason = described.check_prm(params.user_octets(None))
    if reason is not None:
        raise ConfigError(f"{where}: {reason}")
    try:
        inputs = slave.input_fields.fitted(params.input_len, "inputs")
        outputs = slave.output_fields.fitted(params.output_len, "outputs")
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}; a named field would be lost") from None
    return dataclasses.replace(slave, params=params, input_fields=inputs, output_fields=outputs)
