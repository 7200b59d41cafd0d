"""``bus.class2``: the services of a class 2 master, and its connections (MS2) to slaves.

The services reach the slaves of this bus and those of other masters, and take no slave away from its master. Each
service is one request in the spare time of a token hold, with one result or one error.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Generator, Mapping
from dataclasses import dataclass, field

import msgspec
from msgspec import Struct
from msgspec.structs import asdict

from dpstack.api.config.slave import SlaveConfig
from dpstack.api.slave.host import Host
from dpstack.api.slave.records import RecordAccess, RecordWay, usual_timeout
from dpstack.api.slave.services import ConnectionEnd, Services, time_of
from dpstack.api.slave.slave import Slave
from dpstack.api.streams import when_dropped
from dpstack.argcheck import Sealed, octets, whole_number
from dpstack.dp.acyclic.class2 import ChangeAddress, ReadService, Service, ServiceDone
from dpstack.dp.pdu.diag_texts import block_texts
from dpstack.dp.pdu.diagnosis import Diagnosis
from dpstack.dp.pdu.layouts import MAX_RECORD
from dpstack.dp.process_image import Value
from dpstack.dpv1.master.alarm_orders import CloseConnection
from dpstack.dpv1.master.ms2 import NO_CONNECTION
from dpstack.dpv1.master.orders import InitiateDone, OpenConnection, RecordDone, RecordOrder
from dpstack.dpv1.pdu.ms2 import LEAST_INITIATE, Address, InitiateReq
from dpstack.dpv1.pdu.read_write import Function
from dpstack.dpv1.timeouts import least_send_timeout
from dpstack.errors import ConfigError, ConnectionEnded, PduError, UsageError
from dpstack.gsd.dpv1_keywords import NO_GSD, DpV1
from dpstack.gsd.identifiers import Identifier, io_lengths, parse_identifiers
from dpstack.text import brief
from dpstack.units import ns_to_s

#: Slave_Diag of the slave at an address
ReadsDiagnosis = Callable[[int], Awaitable[Diagnosis]]


class ProcessData(Struct, frozen=True):
    """Inputs or outputs read from a slave: ``octets``, and ``values`` by name if the configuration names them."""

    #: octets as read
    octets: bytes
    #: values by name, as far as the configuration names them
    values: Mapping[str, Value] = msgspec.field(default_factory=dict)


class Configuration(Struct, frozen=True):
    """The identifier octets of a slave (Get_Cfg), decoded.

    ``finding``: the reason why they cannot be decoded; then there are no ``identifiers`` and no lengths.
    """

    octets: bytes
    identifiers: tuple[Identifier, ...] = ()
    input_len: int | None = None
    output_len: int | None = None
    finding: str | None = None

    @classmethod
    def of(cls, octets: bytes) -> Configuration:
        """Read ``octets`` as a slave gave them."""
        try:
            return cls(octets, tuple(parse_identifiers(octets)), *io_lengths(octets))
        except ConfigError as error:
            return cls(octets, finding=str(error))


class ReadDiagnosis(Diagnosis, frozen=True):
    """A diagnosis with its ``diagnosis_texts``, as in :attr:`dpstack.Slave.diagnosis_texts`.

    They include texts of the GSD file if this bus has such a slave at that address.
    """

    #: texts, one line each, with those of the GSD file if this bus has such a slave at that address
    diagnosis_texts: tuple[str, ...] = ()


class Class2(Sealed):
    """The class 2 services of one bus. A ``timeout`` in seconds counts from the call, with the time in the queue.

    All services raise UsageError for impossible orders (another address range, a closed bus, 32 services waiting),
    SlaveTimeout when no answer came in time, ServiceRefused when the slave refuses, SlaveFault for an impossible
    answer, BusError when the port vanished meanwhile.
    """

    def __init__(self, bus: Host, slaves: Mapping[int, Slave], find: Callable[[str], Slave]) -> None:
        self._bus = bus
        self._slaves = slaves
        self._find = find
        self._seal(Class2)

    async def diagnosis(self, slave: Slave | str | int, *, timeout: float = 5.0) -> ReadDiagnosis:
        """Slave_Diag. If the slave is in data exchange with this master, the master processes the diagnosis too."""
        return self._read_diagnosis(await self._read(slave, Service.DIAGNOSIS, timeout))

    async def config(self, slave: Slave | str | int, *, timeout: float = 5.0) -> Configuration:
        """Get_Cfg: the identifier octets."""
        return Configuration.of((await self._read(slave, Service.CONFIG, timeout)).outcome.data)

    async def inputs(self, slave: Slave | str | int, *, timeout: float = 5.0) -> ProcessData:
        """RD_Inp: the inputs that the slave sends to its master. The slave must be in data exchange with a master."""
        return await self._process_data(slave, Service.INPUTS, timeout)

    async def outputs(self, slave: Slave | str | int, *, timeout: float = 5.0) -> ProcessData:
        """RD_Outp: the outputs that the slave has received. The slave must be in data exchange with a master."""
        return await self._process_data(slave, Service.OUTPUTS, timeout)

    async def set_address(
        self,
        old: int,
        new: int,
        *,
        ident: int | None = None,
        no_change: bool = False,
        rem_slave_data: bytes = b"",
        force: bool = False,
        timeout: float = 15.0,
    ) -> ReadDiagnosis:
        """Set_Slave_Add: give the slave at ``old`` (126: as delivered) the address ``new``, 0..125.

        Checks before: the slave has ``ident`` and no master, and no station answers at ``new``. Checks after: the same
        device answers at ``new``, and no station at ``old``. Returns the diagnosis read at ``new``. ``no_change``: the
        slave shall refuse every further change (for good; only a reset at the device, if it has one, allows it again).
        ``rem_slave_data``: 0..240 octets that only the device interprets. ``force`` is necessary if a slave of this bus
        (at ``old``, at ``new`` or with that ``ident``) has a GSD file without Set_Slave_Add_supp = 1.

        Raises the errors of the other services. ServiceRefused with status "ignored": the slave kept its address.
        SlaveFault: another device, a slave with a master, ``new`` in use, or a station that still answers at ``old``.
        """
        if self._bus.config.bus.read_only:
            raise UsageError("this bus is read-only: no slave gets another address; leave read_only out")
        whole_number("old", old), whole_number("new", new)
        if not force:
            self._check_settable(old, new, ident)
        services = self._bus.services
        order = ChangeAddress(services.token(), old, new, ident, no_change, rem_slave_data, time_of(timeout))
        return self._read_diagnosis(await services.do(order, ServiceDone))

    def connect(
        self,
        slave: Slave | SlaveConfig | str | int,
        *,
        send_timeout: float | None = None,
        response_timeout: float | None = None,
        profile_ident: int = 0,
        profile_features: int = 0,
        source: bytes = bytes(2),
        destination: bytes = bytes(2),
        timeout: float | None = None,
    ) -> Connecting:
        """Open a class 2 connection (MS2) to any slave: ``async with bus.class2.connect(7) as connection``.

        The slave needs no parameters for it and stays with its master. ``send_timeout`` in seconds: the longest silence
        that both ends agree on (default by baud rate); ``response_timeout``: limit for one service (default:
        C2_Response_Timeout of the GSD file). ``source``, ``destination``: API and access level, and octets of network
        and MAC address if the end is not on this bus. ``timeout``: as for its services. Raises ServiceRefused (all
        connections of the slave are in use, or it has none), ConnectionEnded (the slave aborts), SlaveTimeout,
        SlaveFault, UsageError, BusError.
        """
        address = self._address(slave)
        on_bus = self._slaves.get(address)
        known = slave if isinstance(slave, SlaveConfig) else None if on_bus is None else on_bus.config
        limits = NO_GSD if known is None else known.gsd_dpv1
        usual = least_send_timeout(self._bus.params.baud)
        silence = usual if send_timeout is None else time_of(send_timeout, "send_timeout")
        response = limits.c2_response_ns if response_timeout is None else time_of(response_timeout, "response_timeout")
        order = OpenConnection(
            self._bus.services.token(),
            address,
            InitiateReq(
                silence,
                profile_features=profile_features,
                profile_ident=profile_ident,
                source=_initiate_address("source", source),
                destination=_initiate_address("destination", destination),
            ),
            response,
            limits.c2_max_count_channels,
            timeout_ns=time_of(usual_timeout(response) if timeout is None else timeout),
        )
        return Connecting(
            self._bus.services,
            order,
            f"slave{address}" if known is None else known.name,
            limits,
            self.diagnosis,
            known,
        )

    @property
    def connections(self) -> int:
        """Class 2 connections that are open or being opened."""
        return len(self._bus.services.connections)

    # --- one service --------------------------------------------------------------------------------------------

    async def _read(self, slave: Slave | str | int, service: Service, timeout: float) -> ServiceDone:
        address = self._address(slave)
        known = self._slaves.get(address)
        expected = None
        if known is not None and service in (Service.INPUTS, Service.OUTPUTS):
            expected = known.setup.input_len if service is Service.INPUTS else known.setup.output_len
        services = self._bus.services
        order = ReadService(services.token(), address, service, expected, time_of(timeout))
        return await services.do(order, ServiceDone)

    async def _process_data(self, slave: Slave | str | int, service: Service, timeout: float) -> ProcessData:
        done = await self._read(slave, service, timeout)
        known, data = self._slaves.get(done.address), done.outcome.data
        if known is None:
            return ProcessData(data)
        fields = known.config.input_fields if service is Service.INPUTS else known.config.output_fields
        return ProcessData(data, fields.values(data))

    def _address(self, slave: Slave | SlaveConfig | str | int) -> int:
        """Addresses 0..126, whether this bus knows the slave or not; those it knows also by name."""
        if isinstance(slave, int) and not isinstance(slave, bool):
            return slave
        if isinstance(slave, str):
            return self._find(slave).address
        address = getattr(slave, "address", None)
        if not isinstance(address, int):
            raise UsageError(f"{brief(slave)} is no slave: give its address, 0..126, its name, or bus.slave(...)")
        return address

    def _check_settable(self, old: int, new: int, ident: int | None) -> None:
        """Raises UsageError for a slave whose GSD file excludes Set_Slave_Add."""
        alike = [slave for slave in self._slaves.values() if ident is not None and slave.setup.ident == ident]
        known = self._slaves.get(old) or (alike[0] if alike else self._slaves.get(new) if ident is None else None)
        device = None if known is None else known.config.device
        if known is not None and device is not None and not device.set_slave_add:
            raise UsageError(
                f"{known.who}: its GSD file does not say Set_Slave_Add_supp = 1: its address "
                f"is set at the device (switches, its keypad); force=True asks it all the same"
            )

    def _read_diagnosis(self, done: ServiceDone) -> ReadDiagnosis:
        found = Diagnosis.parse(done.outcome.data)
        if found is None:  # the class 2 master has parsed it before
            raise PduError(f"slave {done.address}: {len(done.outcome.data)} octets are no diagnosis")
        known = self._slaves.get(done.address)
        if known is not None and known.setup.is_other_ident(found.ident):
            known = None  # another device has this address
        lines = block_texts(found) if known is None else known.setup.block_texts(found)
        return ReadDiagnosis(**asdict(found), diagnosis_texts=found.texts + lines)


def _initiate_address(what: str, given: bytes) -> Address:
    data = octets(what, given)
    if len(data) < 2:
        raise UsageError(f"an address in Initiate has API and access level, {len(data)} octets are given")
    return Address(data[0], data[1], data[2:])


class Connection(Sealed, RecordAccess):
    """An open connection. Up to 32 of its services wait in a queue. It ends when the program closes it or the bus, and
    when the program has no reference to it any more: slaves have few connections.

    All services raise ConnectionEnded once the connection has ended (also services under way), otherwise the errors of
    :meth:`Slave.read`: AcyclicError, SlaveTimeout, SlaveFault, UsageError, BusError. ``timeout`` in seconds from the
    call (None: 10, longer if C2_Response_Timeout is); a service that takes the slave longer ends the connection.
    """

    def __init__(self, made: Connecting, done: InitiateDone, ending: ConnectionEnd) -> None:
        services = made.services
        self._made = made
        self._done = done
        self._ending = ending
        longest = min(made.limits.c2_max_data_len or MAX_RECORD, MAX_RECORD, done.max_len)
        self._route = RecordWay(
            services,
            done.address,
            f"slave {done.address} (server SAP {done.server_sap})",
            longest,
            f"it takes {longest} in one service (C2_Max_Data_Len, Max_Len_Data_Unit of Initiate): send less",
            made.order.response_ns,
            asyncio.Lock(),  # the slave handles the I&M calls of each connection separately
            done.token,
        )
        # a program may drop the connection without close()
        when_dropped(self, services.close_connection, done.token, ending)
        self._seal(Connection)

    def _sealed_name(self) -> str:
        return f"connection to slave {self.address}"

    def __repr__(self) -> str:
        return f"<Connection to {self.address} {self.name!r}, server SAP {self._done.server_sap}>"

    @property
    def name(self) -> str:
        """The slave's name on this bus, or "slave" and its address."""
        return self._made.name

    @property
    def address(self) -> int:
        """station address of the slave, 0..126"""
        return self._done.address

    @property
    def _way(self) -> RecordWay:
        return self._route

    @property
    def _slave_config(self) -> SlaveConfig | None:
        return self._made.config

    @property
    def server_sap(self) -> int:
        """The SAP of the slave for this connection, 0..48."""
        return self._done.server_sap

    @property
    def send_timeout(self) -> float:
        """The longest silence in seconds, as both ends agreed."""
        return ns_to_s(self._done.send_timeout_ns)

    @property
    def max_data_len(self) -> int:
        """Octets of data in one service, at most: by Initiate and the GSD file."""
        return self._way.longest

    @property
    def profile_ident(self) -> int:
        """The slave's Profile_Ident_Number, 0 for none."""
        return self._done.profile_ident

    @property
    def is_open(self) -> bool:
        """True until either side has ended it."""
        return not self._ending.ended.is_set()

    @property
    def reason(self) -> str | None:
        """The end that closed the connection, and its reason; None while it is open."""
        ending = self._ending
        return ending.over.reason if ending.over is not None else None if ending.lost is None else str(ending.lost)

    async def transport(self, slot: int, index: int, data: bytes = b"", *, timeout: float | None = None) -> bytes:
        """Data_Transport: send ``data``, return the slave's data."""
        return await self._carry_out(Function.DATA_TRANSPORT, slot, index, timeout, data=data)

    async def ident(self) -> int:
        """The slave's ident number, by Slave_Diag."""
        return (await self._made.diagnosis(self.address)).ident

    async def ended(self) -> None:
        """Wait until either end has ended the connection; :attr:`reason` has the cause."""
        await self._ending.ended.wait()

    async def close(self) -> None:
        """End the connection by Abort; wait until the slave has confirmed or no longer answers. May be repeated."""
        self._way.services.close_connection(self._done.token, self._ending)
        await self._ending.ended.wait()

    async def __aenter__(self) -> Connection:
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def _order(self, order: RecordOrder) -> RecordDone:
        ending = self._ending
        if ending.lost is not None:
            raise ending.lost
        if ending.over is not None:
            text = f"{ending.over.text}; open a new one"
            raise ConnectionEnded(self.address, text, abort=ending.over.abort)
        try:
            return await super()._order(order)
        except UsageError as error:  # the connection ended, its event is still under way
            if not str(error).startswith(NO_CONNECTION):
                raise
            raise ConnectionEnded(self.address, f"slave {self.address}: {error}") from None


@dataclass(eq=False)
class Connecting:
    """A connection that opens: await it, or enter it with ``async with``, which closes it at the end.

    This works once; the second time raises UsageError.
    """

    services: Services
    order: OpenConnection
    name: str
    limits: DpV1
    diagnosis: ReadsDiagnosis
    config: SlaveConfig | None = None
    _begun: bool = field(default=False, init=False)
    _opened: Connection | None = field(default=None, init=False)

    def __await__(self) -> Generator[object, None, Connection]:
        return self._open().__await__()

    async def __aenter__(self) -> Connection:
        self._opened = await self._open()
        return self._opened

    async def __aexit__(self, *_: object) -> None:
        if self._opened is not None:
            await self._opened.close()

    async def _open(self) -> Connection:
        if self._begun:
            raise UsageError("this connection was opened before: call connect() again for another one")
        self._begun = True
        services, order = self.services, self.order
        self._check()
        ending = services.connections[order.token] = ConnectionEnd()
        try:
            done = await services.do(order, InitiateDone, cancel=CloseConnection(order.token))
        except BaseException:
            services.connections.pop(order.token, None)
            raise
        return Connection(self, done, ending)

    def _check(self) -> None:
        """Raises UsageError if the GSD file of the slave excludes the connection or its addresses."""
        who = f"slave {self.order.address} ({self.name})"
        if not self.limits.c2_read_write:
            raise UsageError(f"{who}: its GSD file says C2_Read_Write_supp = 0: it has no class 2 connections")
        try:
            pdu = self.order.request.build()
        except PduError:
            return  # the class 2 master refuses it with the reason
        longest = max(LEAST_INITIATE, self.limits.max_initiate_pdu_length)
        if self.limits.max_initiate_pdu_length and longest < len(pdu):
            raise UsageError(
                f"{who}: Initiate has {len(pdu)} octets with these addresses, its GSD file says "
                f"Max_Initiate_PDU_Length = {longest}: leave network addresses out"
            )
