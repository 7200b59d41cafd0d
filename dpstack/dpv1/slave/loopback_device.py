"""Devices that mirror their outputs to their inputs, the simulation of a ``[[slave]]`` table without a drive.

Inputs that were set from outside replace the mirrored ones.
"""

from __future__ import annotations

from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.record_table import ImOf
from dpstack.dpv1.slave.user_slave import DpSlave
from dpstack.gsd.identifiers import io_lengths


class HeldInputs:
    """The inputs of a mirror as set from outside, in the ``length`` of its inputs. ``octets`` None: it mirrors."""

    def __init__(self, length: int) -> None:
        self.length = length
        self.octets: bytes | None = None

    def cycle(self, outputs: bytes, _now: int) -> bytes:
        """The inputs: as set, or the outputs in the length of the inputs."""
        held = self.octets
        if held is not None:
            return held
        length = self.length
        return outputs if len(outputs) == length else outputs[:length].ljust(length, b"\0")


class MirrorDevice(Device):
    """Inputs are the outputs, cut or filled up with zeros if the lengths differ. Any user parameters are accepted,
    and any address by Set_Slave_Add.

    ``config``: the identifier octets it accepts; ``held``: its inputs from outside. Raises ConfigError if they are
    invalid.
    """

    set_slave_add = True

    def __init__(
        self,
        ident: int,
        config: bytes,
        name: str = "mirror",
        *,
        fail_safe: bool = False,
        held: HeldInputs | None = None,
    ) -> None:
        self.ident = ident
        self.configs = (config,)
        self.name = name
        self.fail_safe = fail_safe
        self._inputs = HeldInputs(io_lengths(config)[0]) if held is None else held

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """The inputs as set, or the outputs in the length of the inputs."""
        held = self._inputs
        if held.octets is None and len(outputs) == held.length:  # as cycle()
            return outputs
        return held.cycle(outputs, now)


class LengthsMirror(MirrorDevice):
    """A mirror of whose slave only the numbers of octets are known: it takes the ident number of any Set_Prm, and any
    identifier octets with these numbers. ``config`` has them, too."""

    other_idents = range(0x10000)

    def check_cfg(self, config: bytes) -> str | None:
        found, own = io_lengths(config), io_lengths(self.configs[0])
        if found == own:
            return None
        return (
            f"{found[0]} octets of inputs and {found[1]} of outputs; the configuration here has {own[0]} and {own[1]}"
        )


def mirror_of(description: SlaveDescription, held: HeldInputs | None = None, im: ImOf = ()) -> DpSlave:
    """A slave of that type, with its one configuration, that mirrors its outputs as :class:`MirrorDevice` does.

    ``im``: its I&M.
    """
    inputs = HeldInputs(io_lengths(description.configs[0])[0]) if held is None else held
    return DpSlave(description, inputs.cycle, im=im)
