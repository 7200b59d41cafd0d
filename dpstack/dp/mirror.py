"""A device that mirrors its outputs to its inputs: what a raw ``[[slave]]`` table is simulated as."""

from __future__ import annotations

from dpstack.dp.device import Device
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
        self._input_len, outputs = io_lengths(config)
        self._padding = bytes(max(0, self._input_len - outputs))

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """What came, in the inputs' length."""
        if len(outputs) == self._input_len:
            return outputs
        return (outputs + self._padding)[: self._input_len]
