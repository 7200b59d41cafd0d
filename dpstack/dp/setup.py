"""What a master must know of a slave before it can bring it up, checked at construction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from dpstack.errors import ConfigError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.identifiers import io_lengths
from dpstack.params import MAX_STATION, UNADDRESSED
from dpstack.units import NS_PER_MS

MAX_USER_PRM: Final = 237


@dataclass(frozen=True, slots=True, kw_only=True)
class SlaveSetup:
    """One slave as the master parameterises it.

    ``ident`` None takes the ident number from the slave's diagnosis. ``config`` are the identifier octets of Chk_Cfg
    (1..244), ``user_prm`` the octets after the seven fixed ones of Set_Prm (0..237). ``watchdog_ms`` 0 is off,
    None lets the master choose from the plan. ``safe`` are the output octets for every way out (default zeros),
    ``initial`` the first ones (default ``safe``). ``groups`` are group numbers 1..8. ``every``: every n-th round.

    Raises :class:`~dpstack.errors.ConfigError`.
    """

    address: int
    name: str
    ident: int | None
    config: bytes
    user_prm: bytes = b""
    watchdog_ms: int | None = None
    min_tsdr: int = 11
    groups: tuple[int, ...] = ()
    sync: bool = False
    freeze: bool = False
    safe: bytes = b""
    initial: bytes | None = None
    fail_safe: bool = False
    every: int = 1
    min_slave_interval_ns: int = 0
    max_tsdr: int | None = None
    #: what the drive or device does when its master stops, for people ("coasts after 200 ms")
    on_loss: str = ""

    def __post_init__(self) -> None:
        where = f"slave {self.address} ({self.name})"
        if not 0 <= self.address <= UNADDRESSED:
            raise ConfigError(f"{where}: the address must be 0..{MAX_STATION} (126 only for a slave as delivered)")
        if self.ident is not None and not 0 <= self.ident <= 0xFFFF:
            raise ConfigError(f"{where}: ident {self.ident:#x} does not fit two octets")
        if not 1 <= len(self.config) <= MAX_DATA:
            raise ConfigError(f"{where}: {len(self.config)} identifier octets; 1..{MAX_DATA} are possible")
        if len(self.user_prm) > MAX_USER_PRM:
            raise ConfigError(f"{where}: {len(self.user_prm)} octets of user parameters; {MAX_USER_PRM} are possible")
        if self.watchdog_ms is not None and not 0 <= self.watchdog_ms <= 650_250:
            raise ConfigError(f"{where}: watchdog_ms {self.watchdog_ms} is outside 0 (off)..650250")
        if any(not 1 <= g <= 8 for g in self.groups):
            raise ConfigError(f"{where}: groups are numbered 1..8")
        if self.every < 1:
            raise ConfigError(f"{where}: every must be 1 or more")
        inputs, outputs = io_lengths(self.config)
        if inputs > MAX_DATA or outputs > MAX_DATA:
            raise ConfigError(f"{where}: {inputs} input and {outputs} output octets; {MAX_DATA} each are possible")
        for name in ("safe", "initial"):
            given = getattr(self, name)
            if given and len(given) != outputs:
                raise ConfigError(f"{where}: {name} has {len(given)} octets, the configuration has {outputs} outputs")

    @property
    def input_len(self) -> int:
        """Octets of input data in a Data_Exchange answer, from the identifier octets."""
        return io_lengths(self.config)[0]

    @property
    def output_len(self) -> int:
        """Octets of output data in a Data_Exchange request, from the identifier octets."""
        return io_lengths(self.config)[1]

    @property
    def safe_outputs(self) -> bytes:
        """The outputs for every way out."""
        return self.safe or bytes(self.output_len)

    @property
    def group_mask(self) -> int:
        """Group_Ident: bit n-1 for group n."""
        return sum(1 << (g - 1) for g in set(self.groups))


def watchdog_factors(watchdog_ms: int) -> tuple[int, int]:
    """WD_Fact_1 and WD_Fact_2 whose product x 10 ms is the shortest time not under ``watchdog_ms`` (1..650250).

    Always rounded up (a shorter watchdog than asked for trips by itself); the smallest effective time that two
    factors 1..255 can give.
    """
    ticks = -(-watchdog_ms // 10)
    best = (255, 255)
    for first in range(1, 256):
        second = -(-ticks // first)
        if second <= 255 and first * second < best[0] * best[1]:
            best = (first, second)
    return best


def watchdog_ns(factors: tuple[int, int]) -> int:
    """The time two factors give with the 10 ms base, in ns."""
    return factors[0] * factors[1] * 10 * NS_PER_MS
