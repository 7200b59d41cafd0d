"""The parameters of one slave at the master, checked at construction; the telegrams of a drive."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Final, Literal

from msgspec import Struct, structs

from dpstack.dp.pdu.diagnosis import FIXED_LEN, MAX_LEN, Diagnosis
from dpstack.dp.pdu.dpv1_status import DPV1_ENABLE, FAIL_SAFE, PUBLISHER_ENABLE, WD_BASE_1MS, Dpv1, set_bit
from dpstack.dp.pdu.prm_blocks import Link
from dpstack.dp.slot_map import SlotMap, slot_map
from dpstack.errors import ConfigError
from dpstack.fdl.telegram import MAX_DATA
from dpstack.gsd.diag_texts import DiagTexts
from dpstack.gsd.identifiers import MAX_USER_PRM, io_lengths
from dpstack.params import DPV1_STATUS_LEN, UNADDRESSED, BusParams
from dpstack.text import octets_text
from dpstack.units import NS_PER_MS, NS_PER_US

#: Min_Slave_Interval counts in 100 us, as GSD files do
INTERVAL_UNIT: Final = 100 * NS_PER_US
MAX_WATCHDOG_MS: Final = 650_250
#: watchdog times whose factors are kept: most slaves of a bus have the same
_KEPT_FACTORS: Final = 64
#: parameter -> lowest value, highest value; address 126 is a slave as delivered
SLAVE_LIMITS: Final = {
    "address": (0, UNADDRESSED),
    "ident": (0, 0xFFFF),
    "watchdog_ms": (0, MAX_WATCHDOG_MS),
    "groups": (1, 8),
    "every": (1, 10_000),
    "max_diag_len": (FIXED_LEN, MAX_LEN),
}
#: the longest watchdog with the 1 ms base
_MAX_FINE_MS: Final = 255 * 255


class WatchdogTime(Struct, frozen=True):
    """A watchdog as Set_Prm says it: two factors 1..255 of a base of 10 ms, or of 1 ms if the slave has that."""

    factors: tuple[int, int]
    base_ms: int = 10

    @property
    def ns(self) -> int:
        """The effective time in ns."""
        return self.factors[0] * self.factors[1] * self.base_ms * NS_PER_MS

    @property
    def ms(self) -> int:
        """The effective time in ms."""
        return self.ns // NS_PER_MS


class OtherTelegram(Struct, frozen=True):
    """``text``: the telegram of the drive and the configured one; ``remedy``: both ways out."""

    text: str
    remedy: str


class IsochronousDemand(Struct, frozen=True):
    """A demand of isochronous mode (DP-V2). ``why``: who demands it; ``window_us``: T_PLL_W, the half width in us in
    which its SYNCH must come."""

    why: str
    window_us: float = 1.0


class DriveTelegrams:
    """``configured``: the name of the telegram in the configuration. ``named``: the name of the drive's telegram with
    these identifier octets, empty if it has none. ``settings``: what sets the drive to a telegram, by its name
    (``o30 = 3``), in force after ``acts``; empty: not known, or the drive follows its master."""

    def __init__(
        self, configured: str, named: Callable[[bytes], str], settings: Mapping[str, str], acts: str = ""
    ) -> None:
        self._configured = configured
        self._named = named
        self._settings = settings
        self._acts = acts

    def other(self, actual: bytes) -> OtherTelegram | None:
        """The words for a drive that names ``actual`` by Get_Cfg; None if that is no other telegram of it."""
        name, wanted = self._named(actual), self._configured
        if not name or name == wanted:
            return None
        own, change = self._settings.get(name), self._settings.get(wanted)
        text = f"the drive is set to {name}{f' ({own})' if own else ''}, the configuration has {wanted}"
        change = f"set the drive to {wanted}" if change is None else f"{change} and {self._acts}"
        return OtherTelegram(text, f'set telegram = "{name}", or {change}')


class SlaveParams(Struct, frozen=True, kw_only=True, repr_omit_defaults=True):
    """The parameters of one slave. Two are equal if all are but the words for people and the GSD file.

    ``ident`` None takes the ident number from the slave's diagnosis. ``ident_adapts``: the device shows another ident
    number until Set_Prm, and takes over the one in it. ``config`` are the identifier octets of Chk_Cfg
    (1..244), ``user_prm`` the octets after the seven fixed ones of Set_Prm (0..237). ``watchdog_ms`` 0 is off,
    None lets the master choose from the plan. ``safe`` are the output octets for every way out (default zeros),
    ``initial`` the first ones (default ``safe``). ``after_return`` "safe": each time that the slave was away its
    outputs stay at their safe values until they are set anew
    (docs/reference/decisions/master.md#outputs-after-a-slave-was-away). ``groups`` are group numbers 1..8. ``every``:
    every n-th round.
    ``wd_base_1ms``: a DP-V1 slave with a watchdog base of 1 ms; its user parameters begin with DPV1_Status_1..3.
    ``dpv1``: DPV1_Enable and what goes with it, for a slave whose user parameters begin so; None: nothing of it.
    ``fail_safe``: it gets empty frames in Clear; ``fail_safe_told``: DPV1_Status_1 says whether, also without ``dpv1``.
    ``max_tsdr``: MaxTsdr in bit times by baud rate, if it is known.
    ``max_diag_len``: octets of its longest diagnosis, 6..244, None: not known.
    ``ignore_auto_clear``: the master stays in Operate without it. ``texts``: what its GSD file says to a diagnosis.

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
    after_return: Literal["resume", "safe"] = "resume"
    fail_safe: bool = False
    fail_safe_told: bool = False
    every: int = 1
    min_slave_interval_ns: int = 0
    max_tsdr: Mapping[int, int] = {}
    max_diag_len: int | None = None
    wd_base_1ms: bool = False
    ignore_auto_clear: bool = False
    dpv1: Dpv1 | None = None
    texts: DiagTexts | None = None
    #: what the drive or device does when its master stops, for people ("coasts after 200 ms")
    on_loss: str = ""
    #: for people, if the slave refuses ``user_prm``: how its GSD file can be read otherwise, and how to ask for that
    prm_note: str = ""
    #: of a drive with a plugin
    telegrams: DriveTelegrams | None = None
    ident_adapts: bool = False
    #: other slaves subscribe to it (DXB): Publisher_Enable, and MSRD in place of SRD
    publishes: bool = False
    #: what it takes from other slaves (DXB): a filter in Set_Prm, in SINAMICS's block with ``sinamics_filter``
    links: tuple[Link, ...] = ()
    sinamics_filter: bool = False
    #: it demands isochronous mode, which this master does not have: it is refused at its bring-up
    isochronous: IsochronousDemand | None = None

    def __post_init__(self) -> None:
        where = self.who
        for key, (low, high) in SLAVE_LIMITS.items():
            value = getattr(self, key)
            for one in value if isinstance(value, tuple) else (value,):
                if one is not None and not low <= one <= high:
                    raise ConfigError(f"{where}: {key} {one} is outside {low}..{high}")
        if not 1 <= len(self.config) <= MAX_DATA:
            raise ConfigError(f"{where}: {len(self.config)} identifier octets; 1..{MAX_DATA} are possible")
        if len(self.user_prm) > MAX_USER_PRM:
            raise ConfigError(f"{where}: {len(self.user_prm)} octets of user parameters; {MAX_USER_PRM} are possible")
        if self.ident_adapts and self.ident is None:
            raise ConfigError(f"{where}: a device that adapts its ident number needs one to adapt to: give configured")
        for key in ("wd_base_1ms", "fail_safe_told", "dpv1"):
            if getattr(self, key) and len(self.user_prm) < DPV1_STATUS_LEN:
                raise ConfigError(
                    f"{where}: {key} needs user_prm that begin with the three DPV1_Status octets, "
                    f"{octets_text(len(self.user_prm))} given"
                )
        if (self.publishes or self.links) and self.dpv1 is None:
            raise ConfigError(f"{where}: data exchange broadcast needs dpv1: it stands in DPV1_Status")
        if self.links and self.watchdog_ms == 0:
            raise ConfigError(f"{where}: it subscribes with watchdog_ms = 0: no time would monitor its links")
        sent = len(self.user_octets(None))
        if sent > MAX_USER_PRM:
            raise ConfigError(f"{where}: {sent} octets of user parameters with its blocks; {MAX_USER_PRM} are possible")
        inputs, outputs = io_lengths(self.config)
        if self.publishes and not inputs:
            raise ConfigError(f"{where}: it has no inputs to publish")
        if inputs > MAX_DATA or outputs > MAX_DATA:
            raise ConfigError(f"{where}: {inputs} input and {outputs} output octets; {MAX_DATA} each are possible")
        for name in ("safe", "initial"):
            given = getattr(self, name)
            if given and len(given) != outputs:
                wanted = f"the configuration has {octets_text(outputs)} of outputs"
                raise ConfigError(f"{where}: {name} has {octets_text(len(given))}, {wanted}")

    def __eq__(self, other: object) -> bool:
        if type(other) is not SlaveParams:
            return NotImplemented
        return all(getattr(self, name) == getattr(other, name) for name in _COMPARED)

    __hash__ = None  # type: ignore[assignment]  # its Mapping has no hash

    def is_other_ident(self, ident: int) -> bool:
        """Whether a device with ``ident`` in its diagnosis is another one. A device that adapts may have any number."""
        return not self.ident_adapts and self.ident not in (None, ident)

    @property
    def who(self) -> str:
        """The slave as it stands in front of messages."""
        return f"slave {self.address} ({self.name})"

    @property
    def has_messages(self) -> bool:
        """Whether its device related blocks are alarms and status messages: DP-V1 is on, or it is a DP-V1 slave by its
        GSD file, and its user parameters set DPV1_Enable, or it is a PROFIBUS PA device by its device file."""
        if self.dpv1 is not None or (self.texts is not None and self.texts.pa_extension is not None):
            return True
        is_slave = self.texts is not None and self.texts.device.dpv1.slave
        return is_slave and len(self.user_prm) >= DPV1_STATUS_LEN and bool(self.user_prm[0] & DPV1_ENABLE)

    def block_texts(self, diagnosis: Diagnosis) -> tuple[str, ...]:
        """The lines for the blocks of its ``diagnosis``, in the words of its GSD file."""
        from dpstack.dp.pdu.diag_texts import block_texts  # here, as a plan needs no diagnosis; a master has loaded it

        return block_texts(diagnosis, self.texts, dpv1=self.has_messages)

    @property
    def slots(self) -> SlotMap:
        """Slots, octets and channels, by its identifier octets and its GSD file."""
        return slot_map(self.config, self.texts)

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
        return group_mask(self.groups)

    def watchdog(self, default_ms: int) -> WatchdogTime | None:
        """The watchdog it gets if ``default_ms`` is the master's recommendation; None is off.

        The 1 ms base is taken if the slave has it and it comes closer.
        """
        wanted = default_ms if self.watchdog_ms is None else self.watchdog_ms
        if not wanted:
            return None
        coarse = WatchdogTime(watchdog_factors(wanted))
        if self.wd_base_1ms and wanted <= _MAX_FINE_MS:
            fine = WatchdogTime(watchdog_factors(wanted, 1), 1)
            return fine if fine.ns < coarse.ns else coarse
        return coarse

    def user_octets(self, watchdog: WatchdogTime | None) -> bytes:
        """The user parameters as they are sent: WD_Base_1ms is the base of ``watchdog``, Fail_Safe what Clear is."""
        octets = bytearray(self.user_prm)
        if self.wd_base_1ms:
            set_bit(octets, 0, WD_BASE_1MS, watchdog is not None and watchdog.base_ms == 1)
        if self.fail_safe_told or self.dpv1 is not None:
            set_bit(octets, 0, FAIL_SAFE, self.fail_safe)
        dpv1 = self.dpv1
        if dpv1 is not None:
            if self.links:
                from dpstack.dp.pdu.dxb import block_of  # here, as few slaves subscribe

                block = block_of(self.links, sinamics=self.sinamics_filter)
                dpv1 = structs.replace(dpv1, blocks=(*dpv1.blocks, block))
            dpv1.apply(octets)
            if self.publishes:
                set_bit(octets, 0, PUBLISHER_ENABLE, True)
        return bytes(octets)

    def on_bus(self, params: BusParams) -> SlaveParams:
        """The same slave on the bus with ``params``: a publisher has a min T_SDR of its own there."""
        least = params.publisher_min_tsdr if self.publishes else 0
        return self if self.min_tsdr >= least else structs.replace(self, min_tsdr=least)


_COMPARED: Final = [name for name in SlaveParams.__struct_fields__ if name not in ("texts", "prm_note", "telegrams")]


def group_mask(groups: tuple[int, ...]) -> int:
    """Bit n-1 for group n, as in Group_Ident and Group_Select."""
    return sum(1 << (g - 1) for g in set(groups))


@lru_cache(_KEPT_FACTORS)
def watchdog_factors(watchdog_ms: int, base_ms: int = 10) -> tuple[int, int]:
    """WD_Fact_1 and WD_Fact_2 whose product x ``base_ms`` is the shortest time not under ``watchdog_ms``
    (1..650250 with 10 ms, 1..65025 with 1 ms).

    Always rounded up (a shorter watchdog than asked for trips by itself); the smallest effective time that two
    factors 1..255 can give.
    """
    ticks = -(-watchdog_ms // base_ms)
    best = (255, 255)
    for first in range(1, 256):
        second = -(-ticks // first)
        if second <= 255 and first * second < best[0] * best[1]:
            best = (first, second)
    return best
