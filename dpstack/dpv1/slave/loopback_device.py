"""Devices that mirror their outputs to their inputs, the simulation of a ``[[slave]]`` table without a drive."""

from __future__ import annotations

from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.gsd.identifiers import io_lengths


class MirrorDevice(Device):
    """Inputs are the outputs, cut or filled up with zeros where the lengths differ. Any user parameters are accepted,
    and any address by Set_Slave_Add.

    ``config``: the identifier octets it accepts. Raises ConfigError where they are none.
    """

    set_slave_add = True

    def __init__(self, ident: int, config: bytes, name: str = "mirror", *, fail_safe: bool = False) -> None:
        self.ident = ident
        self.configs = (config,)
        self.name = name
        self.fail_safe = fail_safe
        self._input_len = io_lengths(config)[0]

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """The outputs in the length of the inputs."""
        return fitted(outputs, self._input_len)


def mirror_of(description: SlaveDescription) -> DpSlave:
    """A slave of that type, with its one configuration, that mirrors its outputs as :class:`MirrorDevice` does."""
    inputs = io_lengths(description.configs[0])[0]
    return DpSlave(description, lambda outputs, elapsed: fitted(outputs, inputs))


def fitted(outputs: bytes, length: int) -> bytes:
    """``outputs`` in another length: cut, or filled up with zeros."""
    return outputs if len(outputs) == length else outputs[:length].ljust(length, b"\0")
