"""The slave that a user builds: a description and one function from outputs and elapsed time to inputs."""

from __future__ import annotations

import contextlib
from collections.abc import Awaitable, Callable, Iterator
from functools import partial
from typing import Any, TypedDict, Unpack

from dpstack.argcheck import Sealed, functions, octets, whole_number
from dpstack.dp.pdu.diag_blocks import NO_DIAG, UserDiag
from dpstack.dp.pdu.diagnosis import FIXED_LEN
from dpstack.dp.pdu.prm_blocks import PrmBlock
from dpstack.dp.slave.device import Leave
from dpstack.dpv1.pdu.im import Im
from dpstack.dpv1.pdu.ms2 import InitiateReq
from dpstack.dpv1.pdu.read_write import PARAMETER_INDEX
from dpstack.dpv1.slave.alarms import AlarmServer
from dpstack.dpv1.slave.description import SlaveDescription
from dpstack.dpv1.slave.device import Device
from dpstack.dpv1.slave.record_requests import Records
from dpstack.dpv1.slave.record_table import ByIndex, ImOf, ImRecords
from dpstack.dpv1.slave.resource_manager import check_ms2
from dpstack.errors import ConfigError
from dpstack.gsd.identifiers import io_lengths

#: from the outputs and the time since data exchange began in ns to the inputs
OnCycle = Callable[[bytes, int], bytes | bytearray]
#: keeps the address, No_Add_Chg and the device's octets of Set_Slave_Add where they survive a restart
#: (:meth:`~dpstack.dpv1.slave.device.Device.address_set`)
OnAddress = Callable[[int, bool, bytes], None]
#: keeps a record of I&M1 to I&M4, which a master wrote in a slot, where it survives a restart
OnIm = Callable[[int, Im], None]
#: a record's octets from slot and index; from slot, index and octets to nothing. Both may take their time, and raise
#: :class:`~dpstack.errors.RecordRefused`.
OnRead = Callable[[int, int], Awaitable[bytes]]
OnWrite = Callable[[int, int, bytes], Awaitable[None]]
#: serves Data_Transport: from slot, index and octets to octets, up to 240 each way
OnTransport = Callable[[int, int, bytes], Awaitable[bytes]]
#: judges an Initiate of a master of class 2; it raises :class:`~dpstack.errors.RecordRefused` to refuse it
OnInitiate = Callable[[int, InitiateReq], None]


class SlaveOptions(TypedDict, total=False):
    """The options of :class:`DpSlave`, which :func:`dpstack.slave.slave_from_gsd` takes too."""

    config: bytes | None
    safe: bytes | None
    on_prm: Callable[[bytes], str | None] | None
    on_blocks: Callable[[tuple[PrmBlock, ...]], str | None] | None
    on_address: OnAddress | None
    on_leave: Callable[[Leave], None] | None
    on_read: OnRead | None
    on_write: OnWrite | None
    on_transport: OnTransport | None
    on_initiate: OnInitiate | None
    im: ImOf
    on_im: OnIm | None
    parameters: Records | None
    ms2: int | None


class DpSlave(Sealed, Device):
    """A slave of the type ``description`` whose inputs are the result of ``on_cycle(outputs, elapsed)``.

    ``on_cycle`` gets the outputs in the length of the configuration in use and ``elapsed``, the ns since data exchange
    began; it returns the inputs in their length. It is called in every Data_Exchange, at SYNC and FREEZE, and
    **with the safe outputs** as soon as the real ones end: at Clear, an empty frame, the watchdog, any way out of data
    exchange. ``safe``: these octets, default zeros; only if all configurations have that length. ``config``: the
    answer to Get_Cfg until a master has configured the slave: the modules that are plugged in.

    ``on_prm(user_prm)`` judges user parameters: it returns a reason to refuse them, or None; ``on_blocks(blocks)`` does
    so with the structured ones of a DP-V1 slave (empty without any; wrong lengths are refused before).
    ``on_address`` keeps the address of Set_Slave_Add; without it the slave has its old one after a restart.
    ``on_leave(reason)`` is called with the reason why data exchange ended. An exception of any of them takes this slave
    out of data exchange, with safe outputs and Stat_Diag, until it is restarted; nothing else is disturbed.

    ``on_read`` and ``on_write`` serve the records of DP-V1, ``on_transport`` the Data_Transport of class 2
    (:func:`dpstack.slave.serve_slave` runs them), one at a time for each master or connection. Their exceptions are
    answered and reported, nothing else ends; they are cancelled when the master gives up. ``on_initiate(master,
    wanted)`` may refuse a connection of class 2 by RecordRefused (a negative response). ``ms2``: the number of
    connections of class 2, default the description's. ``im``: I&M0, and those of I&M1 to 4 that a master may write, for
    every slot alike or as a table slot -> I&M. ``on_im(slot, record)`` keeps a record of I&M that a master writes where
    it survives a restart; an exception is answered (RecordRefused: as it says), and nothing is changed. ``parameters``
    serves record 47, the parameter channel of PROFIdrive (:class:`dpstack.profile.record47.TimedRecords`), instead of
    these functions. By ``alarm_server`` a slave with DP-V1 raises alarms and sends status messages
    (:class:`~dpstack.dpv1.slave.alarms.AlarmServer`); a served slave has them as async calls.

    Set :attr:`diag`, as a whole and whenever something changes, to the slave's own part of its diagnosis. Raises
    ConfigError.
    """

    def __init__(
        self,
        description: SlaveDescription,
        on_cycle: OnCycle,
        **options: Unpack[SlaveOptions],
    ) -> None:
        _check_description(description)
        who = f"slave {description.name}"
        unknown = sorted(options.keys() - SlaveOptions.__annotations__.keys())
        if unknown:
            raise TypeError(f"DpSlave() got an unexpected keyword argument {unknown[0]!r}")
        calls: dict[str, Any] = {name: given for name, given in options.items() if name.startswith("on_")}
        functions(who, ConfigError, on_cycle=on_cycle, **calls)
        config, safe, ms2 = options.get("config"), options.get("safe"), options.get("ms2")
        first = description.default_config
        real = first if config is None else octets(f"{who}: config", config, ConfigError)
        reason = description.check_cfg(real)
        if reason is not None:
            raise ConfigError(f"{who}: {reason}")
        #: ident number of the description
        self.ident = description.ident
        self.name = description.name
        #: the type of the slave
        self.description = description
        self._on_cycle = on_cycle
        self._calls = calls
        self._since = 0  # data exchange began
        self.configs = tuple(dict.fromkeys((real, *description.configs)))
        safe = None if safe is None else octets(f"{who}: safe", safe, ConfigError)
        if safe is not None and description.modules:
            raise ConfigError(f"{who}: a modular slave has zeros as safe outputs; leave safe out")
        if safe is not None and {len(safe)} != {io_lengths(known)[1] for known in self.configs}:
            raise ConfigError(f"{who}: {len(safe)} safe octets are not the outputs of every configuration")
        self.sync_supported = description.sync
        self.freeze_supported = description.freeze
        self.fail_safe = description.fail_safe or description.fail_safe_required
        self.fail_safe_required = description.fail_safe_required
        self.set_slave_add = description.set_slave_add
        self.wd_base_1ms = description.wd_base_1ms
        self.max_diag_len = description.max_diag_len
        if description.dpv1:
            #: raises alarms and sends status messages; None without DP-V1
            self.alarm_server = AlarmServer(description.alarm_support, self.max_diag_len - FIXED_LEN, self.name)
        self.dxb = description.dxb
        self._diag = NO_DIAG
        #: outputs until a master sends some; empty for zeros
        self.safe = safe or b""
        self._safe = b""  # in the length of the configuration in use
        #: serves Read, see the class; None: refused
        self.on_read = options.get("on_read")
        #: serves Write, see the class; None: refused
        self.on_write = options.get("on_write")
        #: serves Data_Transport of class 2, see the class; None: refused
        self.on_transport = options.get("on_transport")
        #: connections of class 2, 0..49
        self.ms2 = description.ms2 if ms2 is None else whole_number(f"{who}: ms2", ms2, ConfigError)
        self.ms2_max_len = description.ms2_max_len
        self.ms2_max_initiate = description.ms2_max_initiate
        check_ms2(who, self.ms2, self.ms2_max_len, self.ms2_max_initiate)
        im, parameters = options.get("im", ()), options.get("parameters")
        given = tuple(im) if isinstance(im, Iterator) else im
        if parameters is not None and not hasattr(parameters, "ask"):
            raise ConfigError(f"{who}: parameters = {parameters!r}: give dpstack.profile.record47.TimedRecords")
        self._parameters = parameters
        self._im = ImRecords(given, changed=partial(self._call, "on_im")) if given else None
        self.serve_records(None)
        #: one of the user's functions runs at this moment
        self.inside = False
        self._seal(DpSlave)

    def _sealed_name(self) -> str:
        return f"slave {self.name}"

    # --- for the user at any time -------------------------------------------------------------------------------

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r} 0x{self.ident:04X}>"

    @property
    def diag(self) -> UserDiag:
        """The diagnosis of the slave; the master fetches a new one at once. TypeError for anything else."""
        return self._diag

    @diag.setter
    def diag(self, diag: UserDiag) -> None:
        if not isinstance(diag, UserDiag):
            raise TypeError(f"slave {self.name}: diag is a UserDiag, for instance UserDiag.of(device_block(b'...'))")
        self._diag = diag

    def user_diag(self) -> UserDiag:
        """The diagnosis as it was set."""
        return self._diag

    @property
    def im(self) -> tuple[Im, ...]:
        """Its I&M, that of slot 0, as it stands now, by number; a master may have written some of it."""
        return self.im_of(0)

    def im_of(self, slot: int) -> tuple[Im, ...]:
        """I&M of ``slot`` as it stands now, by number; empty if it has none."""
        return () if self._im is None else self._im.of(slot)

    def serve_records(self, others: Records | None) -> None:
        """Let ``others`` serve the records beside I&M and parameters."""
        if self._parameters is not None:
            others = ByIndex({PARAMETER_INDEX: self._parameters}, others)
        if self._im is not None:
            self._im.others = others
        self.records = others if self._im is None else self._im

    # --- Device -------------------------------------------------------------------------------------------------

    def check_prm(self, user_prm: bytes) -> str | None:
        """Lengths by the description, the rest by the user's own checks."""
        reason = self.description.check_prm(user_prm)
        if reason is None:
            reason = self._call("on_prm", user_prm)
        if reason is None:
            reason = self._call("on_blocks", self.description.blocks(user_prm))
        return reason

    def check_cfg(self, config: bytes) -> str | None:
        return self.description.check_cfg(config)

    def enter(self, config: bytes, now: int) -> None:
        self._since = now
        self._safe = self.safe or bytes(io_lengths(config)[1])

    def exchange(self, outputs: bytes, now: int) -> bytes:
        """Hand over to the user's function, which may return a bytearray that it goes on writing to."""
        self.inside = True
        try:
            inputs = self._on_cycle(outputs, now - self._since)
        finally:
            self.inside = False
        return bytes(inputs) if isinstance(inputs, bytearray) else inputs

    def clear(self, now: int) -> None:
        self.exchange(self._safe, now)

    def leave(self, reason: Leave, now: int) -> None:
        """Safe outputs at once, also to a function that has just failed: whatever it still does must be safe."""
        ignored = contextlib.suppress(Exception) if reason is Leave.FAILURE else contextlib.nullcontext()
        with ignored:
            self.exchange(self._safe, now)
        self._call("on_leave", reason)

    def address_set(self, address: int, fixed: bool, rem_slave_data: bytes) -> bool:
        """Kept where the user keeps it."""
        self._call("on_address", address, fixed, rem_slave_data)
        return self._calls.get("on_address") is not None

    def initiate(self, master: int, wanted: InitiateReq) -> None:
        self._call("on_initiate", master, wanted)

    def _call(self, name: str, *args: object) -> Any:
        """Call the user's function ``name``, if there is one; :attr:`inside` is True meanwhile."""
        function = self._calls.get(name)
        if function is None:
            return None
        self.inside = True
        try:
            return function(*args)
        finally:
            self.inside = False


def _check_description(given: object) -> None:
    if not isinstance(given, SlaveDescription):
        raise ConfigError(
            f"a DpSlave is made of a SlaveDescription, not of {given!r}: SlaveDescription.simple(0x1234, inputs=2, "
            f"outputs=1) for instance; slave_from_gsd(...) makes one of a GSD file"
        )
