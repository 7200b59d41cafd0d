"""What can be changed of a slave while the bus runs, checked as its [[slave]] table is."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any, Final, TypedDict

from dpstack.api.config.dpv1 import read_dpv1
from dpstack.api.config.slave import SlaveConfig
from dpstack.api.config.table import Source, Table
from dpstack.dp.pdu.dpv1_status import Dpv1
from dpstack.errors import ConfigError, UsageError

_DPV1: Final = "dpv1"
#: what is sent in Set_Prm is the same at every rate
_ANY_RATE: Final = 500_000


class Changes(TypedDict, total=False):
    """What :meth:`~dpstack.api.slave.slave.Slave.reparameterise` can change; ``config`` are the identifier octets.

    ``dpv1`` as in a configuration: True, False, or a table of its keys, which says all (what is left out is as if it
    had never been given); None: what GSD file and parameters say.
    """

    user_prm: bytes
    config: bytes
    ident: int | None
    watchdog_ms: int | None
    groups: tuple[int, ...]
    sync: bool
    freeze: bool
    fail_safe: bool
    safe: bytes
    every: int
    min_slave_interval_ns: int
    wd_base_1ms: bool
    ignore_auto_clear: bool
    dpv1: bool | Mapping[str, object] | None


def changed(slave: SlaveConfig, changes: Changes) -> SlaveConfig:
    """``slave`` after ``changes``, held against its names for process data and its GSD file.

    Raises UsageError for a change there is not, ConfigError.
    """
    unknown = sorted(set(changes) - set(Changes.__annotations__))
    if unknown:
        known = ", ".join(sorted(Changes.__annotations__))
        raise UsageError(f"{unknown[0]!r} cannot be changed; these can: {known}")
    plain: dict[str, Any] = {key: value for key, value in changes.items() if key != _DPV1}
    if "user_prm" in plain:
        plain["prm_note"] = ""  # these are not the GSD file's
    other = dataclasses.replace(slave, **plain)
    if _DPV1 in changes:
        other = dataclasses.replace(other, dpv1=_dpv1(other, changes["dpv1"]))
        if slave.profile is not None and not slave.raw and (slave.dpv1 is None) is not (other.dpv1 is None):
            raise UsageError(
                f"slave {slave.address} ({slave.name}): DP-V1 on or off decides how its drive plugin asks for "
                f"parameters: remove the slave and add it with another dpv1"
            )
    return _refitted(other)


def _dpv1(slave: SlaveConfig, given: bool | Mapping[str, object] | None) -> Dpv1 | None:
    data = {} if given is None else {_DPV1: given}
    table = Table(Source("reparameterise"), (), data, f"slave {slave.address} ({slave.name})")
    return read_dpv1(table, slave.device, slave.user_prm)


def _refitted(slave: SlaveConfig) -> SlaveConfig:
    where, told = f"slave {slave.address} ({slave.name})", slave.description
    if told is not None:
        for key, supported in (("sync", told.sync), ("freeze", told.freeze)):
            if getattr(slave, key) and not supported:
                raise ConfigError(f"{where}: its GSD file says {key.capitalize()}_Mode_supp = 0; leave {key} out")
        sent = slave.setup(_ANY_RATE).user_octets(None)
        reason = told.check_prm(sent) if slave.config in told.configs else None
        if reason is not None:
            raise ConfigError(f"{where}: {reason}")
    try:
        inputs = slave.input_fields.fitted(slave.input_len, "inputs")
        outputs = slave.output_fields.fitted(slave.output_len, "outputs")
    except ConfigError as error:
        raise ConfigError(f"{where}: {error}; a named field would be lost") from None
    return dataclasses.replace(slave, input_fields=inputs, output_fields=outputs)
