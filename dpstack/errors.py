"""The exception classes of dpstack: one tree.

::

    DpError
    +-- ConfigError (ValueError)        a configuration or an argument that cannot work; names file and line
    |   +-- ParamError                  a bus parameter outside its limits
    |   +-- GsdError                    a GSD file that cannot be used, or a wish it does not allow
    +-- UsageError (RuntimeError)       a call that does not fit the state: misuse, raised at once
    +-- PduError (ValueError)           the octets of a DP service that cannot be; names the octet
    +-- PortError (OSError)             the serial port: missing, held, refused, vanished
    |   +-- PortBusyError               held by another program (named)
    |   +-- BaudError                   the port cannot do the rate, or substituted another
    +-- BusError                        the bus as a whole cannot work
    |   +-- OrderDropped                an order, or outputs, that the bus process did not take in time
    +-- SlaveError                      one slave; carries its address
    |   +-- SlaveFault                  refused parameters or configuration, wrong ident, locked, lying
    |   +-- CpuRefused                  an S7-200 says no to a request over PPI; carries request and code
    |   +-- ServiceRefused              answered a service of this master with no; carries service and status
    |   +-- SlaveTimeout (TimeoutError) did not reach what was awaited in time
    |   +-- AcyclicError                a negative answer of DP-V1: class, code and text
    |   +-- ConnectionEnded             a class 2 connection is over: who ended it, and why
    |   +-- HartError                   a HART command without a usable answer: of module, wires or device
    +-- FdlError                        an FDL service whose confirmation is not positive; carries it
    +-- RecordRefused                   raised by a function of one's own slave: its negative answer
    +-- AlarmError                      an alarm of one's own slave that its master does not acknowledge; says why
    +-- DriveError                      one drive; carries its name
        +-- DriveFault                  tripped, or refuses to do what was asked: names fault and remedy
        +-- DriveTimeout (TimeoutError) did not reach the wanted state in time: names what is missing
        +-- ParameterError              a negative answer of the parameter channel: number and the manual's text

Misuse and wrong configurations raise at once. An error of a peer on the wire never raises in the core: it becomes an
event and a counter, and one of the lower branches if a caller waits for the result. Every argument of a constructor
is an attribute of the same name: so an error keeps its class across the control socket
(``dpstack.api.control.errors``).
"""

from __future__ import annotations

from dpstack.text import printable


class DpError(Exception):
    """The root of all exceptions that dpstack raises.

    Its text may hold names out of files and from devices; :func:`str`, as in tracebacks and loggers, escapes terminal
    controls in them (:mod:`dpstack.text`).
    """

    def __str__(self) -> str:
        return printable(super().__str__())


class ConfigError(DpError, ValueError):
    """A configuration that cannot work. The text says where (file and line when there is a file) and what to do."""

    #: line in the file; None for an error without one
    line: int | None = None
    #: the problem without its place; empty if the error has no such part
    what: str = ""
    #: the remedy; empty if the error has no such part
    todo: str = ""

    @classmethod
    def at(cls, place: str, line: int | None, what: str, todo: str) -> ConfigError:
        """The error ``place:line: what; todo``."""
        error = cls(f"{place}{'' if line is None else f':{line}'}: {what}; {todo}")
        error.line, error.what, error.todo = line, what, todo
        return error


class ParamError(ConfigError):
    """A bus parameter outside the limits of the standard."""


class GsdError(ConfigError):
    """A GSD file that cannot be used at all, or modules and parameters that do not fit it (``what; what to do``)."""


class CaptureFileError(DpError, ValueError):
    """A capture file that cannot be read, or not further; the text names the file and the place in it."""


class UsageError(DpError, RuntimeError):
    """A call that does not fit the state, for instance on a bus that is closed."""


class UnknownAttribute(UsageError, AttributeError):
    """An attribute was assigned that the object does not have; the text names the nearest one."""


class PduError(DpError, ValueError):
    """Octets of a DP service PDU that cannot be read, or values that cannot be put into one; names the octet.

    Inside the core the parser's caller catches it: wrong octets of a peer become an event there.
    """


class PortError(DpError, OSError):
    """The port does not exist, may not be opened, or vanished."""


class PortBusyError(PortError):
    """Another program holds the port."""


class BaudError(PortError):
    """The port cannot do the wanted baud rate or silently substituted another one."""


class BusError(DpError):
    """The bus as a whole cannot work (own address in use, nothing but noise, closed by a fault)."""


class OrderDropped(BusError):
    """The bus process did not take an order, or outputs, in time. They were dropped: they will not be carried out."""


class SlaveError(DpError):
    """Something about one slave. ``address`` is its station address."""

    def __init__(self, address: int, message: str) -> None:
        super().__init__(message)
        #: station address of the slave, 0..126
        self.address = address


class SlaveFault(SlaveError):
    """The slave refused parameters or configuration, is another device, is owned by another master, or lies."""


class NoInputs(SlaveError, LookupError):
    """There are no inputs of the slave at this moment: it is not in data exchange, or they are too old to be valid."""


class ServiceRefused(SlaveError):
    """The slave said no to one service (``service`` by name), or acknowledged it and did nothing.

    ``status`` is its answer: "RS", "RR", "UE" ..., or "ignored".
    """

    def __init__(self, address: int, message: str, *, service: str, status: str) -> None:
        super().__init__(address, message)
        #: name of the service
        self.service = service
        #: answer of the slave: "RS", "RR", "UE" ..., or "ignored"
        self.status = status


class CpuRefused(SlaveError):
    """An S7-200 says no to a request over PPI. ``service``: what was asked, ``code``: its return code or error."""

    def __init__(self, address: int, message: str, *, service: str, code: int) -> None:
        super().__init__(address, message)
        #: the request, for instance "read AQW0"
        self.service = service
        #: return code of an item, 0..255, or class and code of an error, 0..65535
        self.code = code


class AcyclicError(SlaveError):
    """A negative answer to a DP-V1 ``service`` (Read, Write) of ``slot`` and ``index``.

    ``error_class`` and ``error_code`` are the halves of ``code_1``.
    """

    def __init__(
        self, address: int, message: str, *, service: str, slot: int, index: int, codes: tuple[int, int, int]
    ) -> None:
        super().__init__(address, message)
        #: "Read" or "Write"
        self.service = service
        #: slot of the request, 0..254
        self.slot = slot
        #: index of the request, 0..255
        self.index = index
        #: the three codes as answered: Error_Decode, Error_Code_1, Error_Code_2
        self.codes = codes
        #: Error_Decode; 0x80 for the codes of DP-V1
        self.error_decode: int
        #: Error_Code_1, class and code in one octet; 0xB5 is "state conflict"
        self.code_1: int
        #: Error_Code_2, the device's own
        self.code_2: int
        self.error_decode, self.code_1, self.code_2 = codes

    def about(self, what: str) -> AcyclicError:
        """The same error with ``what``, the purpose of the service, in front of its text."""
        return AcyclicError(
            self.address,
            f"{what}: {self}",
            service=self.service,
            slot=self.slot,
            index=self.index,
            codes=self.codes,
        )

    @property
    def error_class(self) -> int:
        """Error_Class 0..15: 10 application, 11 access, 12 resource."""
        return self.code_1 >> 4

    @property
    def error_code(self) -> int:
        """Error_Code 0..15 within the class."""
        return self.code_1 & 0x0F


class ConnectionEnded(SlaveError):
    """A service over a class 2 connection that is over; the text says who ended it and why. Open a new one."""

    def __init__(self, address: int, message: str, *, abort: tuple[int, int, int] | None = None) -> None:
        super().__init__(address, message)
        #: subnet, instance and reason of the Abort that ended it (``dpstack.dpv1.pdu.ms2``); None without one
        self.abort = abort


class HartError(SlaveError):
    """A HART command through a module of the slave that has no usable answer.

    ``reason``: "absent" (no HART module in the slot), "channel" (the module has no such channel), "timeout" (no answer
    yet, or the device stays busy), "module" (the module reports an error), "damaged" (an impossible answer), "refused"
    (by the device).
    """

    def __init__(self, address: int, message: str, *, reason: str, response_code: int | None = None) -> None:
        super().__init__(address, message)
        #: "absent", "channel", "timeout", "module", "damaged" or "refused"
        self.reason = reason
        #: HART response code of the device; None without an answer of it
        self.response_code = response_code


class SlaveTimeout(SlaveError, TimeoutError):
    """The slave did not reach the awaited state, or did not answer, in time."""


class FdlError(DpError):
    """An FDL ``service`` (SDA, SRD ...) to the station ``address`` whose confirmation ``status`` is not positive.

    ``status``: UE, RR, RS, RDL, RDH or NR as the station answered, NA without a plausible answer; LS, LR, DS, IV if
    this station sent nothing. ``data``: reply data beside RDL and RDH.
    """

    def __init__(self, address: int, message: str, *, service: str, status: str, data: bytes = b"") -> None:
        super().__init__(message)
        #: station address of the request, 0..127
        self.address = address
        #: name of the service: "SDA", "SDN", "SRD", "MSRD", "FDL_STATUS", "IDENT", "LSAP_STATUS"
        self.service = service
        #: the confirmation: "UE", "RR", "RS", "RDL", "RDH", "NR", "NA", "LS", "LR", "DS" or "IV"
        self.status = status
        #: reply data beside RDL and RDH, else empty
        self.data = data


class RecordRefused(DpError):
    """A function that serves records raises it to refuse a request: ``code_1`` is Error_Code_1, class and code.

    0xB0 invalid index, 0xB2 invalid slot, 0xB5 state conflict, 0xB6 access denied ...
    (``dpstack.dpv1.pdu.error_codes.Code``). Both are octets; raises UsageError for anything else.
    """

    def __init__(self, code_1: int, code_2: int = 0) -> None:
        for name, code in (("code_1", code_1), ("code_2", code_2)):
            if not isinstance(code, int) or not 0 <= code <= 0xFF:
                raise UsageError(f"RecordRefused: {name} = {code!r} is no octet; 0xB0 says invalid index, for instance")
        super().__init__(f"record refused: Error_Code_1 0x{code_1:02X}, Error_Code_2 0x{code_2:02X}")
        #: Error_Code_1, class and code: 0xB0 invalid index, 0xB2 invalid slot, 0xB5 state conflict ...
        self.code_1 = code_1
        #: Error_Code_2, the maker's own
        self.code_2 = code_2


class AlarmError(DpError):
    """An alarm or status of one's own slave that does not reach its master, or is not acknowledged.

    ``reason``: "not supported" (by this slave), "not enabled" (by its master), "not in data exchange", "queue full",
    "data exchange ended", "withdrawn" (by the caller that raised it).
    """

    def __init__(self, message: str, reason: str) -> None:
        super().__init__(message)
        self.reason = reason


class DriveError(DpError):
    """Something about one drive. ``drive`` is its name in the configuration."""

    def __init__(self, drive: str, message: str) -> None:
        super().__init__(message)
        #: name of the drive in the configuration
        self.drive = drive


class DriveFault(DriveError):
    """The drive tripped or refuses to do what was asked; the text names the reason and the parameter to change."""


class DriveTimeout(DriveError, TimeoutError):
    """The drive did not reach the wanted state in time; the text says what it reports instead."""


class ParameterError(DriveError):
    """A negative answer of the drive's parameter channel. ``number`` is the drive's error number."""

    def __init__(self, drive: str, number: int, message: str) -> None:
        super().__init__(drive, message)
        #: error number of the drive
        self.number = number
