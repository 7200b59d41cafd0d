"""USB/IP between one emulated device and the kernel's virtual host controller (``vhci_hcd``), over a socket pair."""

from __future__ import annotations

import socket
import struct
from collections import defaultdict, deque
from collections.abc import Callable
from pathlib import Path
from typing import Final, Protocol

_CONTROLLER: Final = Path("/sys/devices/platform/vhci_hcd.0")
#: command, sequence number, device, direction (1: to the host), endpoint
_HEAD: Final = struct.Struct(">5I")
_HEADER_SIZE: Final = 48
_SUBMIT, _UNLINK, _SUBMITTED, _UNLINKED = 1, 2, 3, 4
_EPIPE, _ECONNRESET = 32, 104
FULL_SPEED, HIGH_SPEED = 2, 3


class Device(Protocol):
    """The device behind the connection."""

    speed: int

    def control(self, setup: bytes, data: bytes) -> bytes | None:
        """The answer to a control transfer; None: it stalls."""

    def out(self, data: bytes, taken: Callable[[], None]) -> None:
        """Octets of the bulk endpoint; ``taken`` is called once there is room for them."""

    def data_in(self, endpoint: int, size: int) -> bytes | None:
        """Octets for one transfer to the host of at most ``size``; None: not yet."""


class Connection:
    """``device`` plugged into the controller. ``fd`` is to be read with :meth:`readable`."""

    def __init__(self, device: Device) -> None:
        self._device = device
        self._socket: socket.socket | None = None
        self._received = bytearray()
        self._slot = 0
        #: transfers to the host that wait for octets, by endpoint: sequence number and size
        self._waiting: defaultdict[int, deque[tuple[int, int]]] = defaultdict(deque)

    @property
    def fd(self) -> int:
        return -1 if self._socket is None else self._socket.fileno()

    def attach(self, slot: int) -> None:
        ours, theirs = socket.socketpair()
        with theirs:
            words = f"{slot} {theirs.fileno()} {0x10000 + slot + 1} {self._device.speed}"
            (_CONTROLLER / "attach").write_text(words)
        self._socket, self._slot = ours, slot
        self._received.clear()

    def detach(self) -> None:
        (_CONTROLLER / "detach").write_text(str(self._slot))
        if self._socket is not None:
            self._socket.close()
        self._socket = None
        self._waiting.clear()

    def feed(self, endpoint: int) -> None:
        """Give the host what the device has for ``endpoint``, as long as it asks for something."""
        waiting = self._waiting[endpoint]
        while waiting:
            octets = self._device.data_in(endpoint, waiting[0][1])
            if octets is None:
                return
            number, _size = waiting.popleft()
            self._answer(number, octets)

    def readable(self) -> bool:
        """Carry out what the host wants; False: it has gone."""
        assert self._socket is not None
        chunk = self._socket.recv(1 << 16)
        self._received += chunk
        while len(self._received) >= _HEADER_SIZE and self._one():
            pass
        return bool(chunk)

    def _one(self) -> bool:
        octets = self._received
        command, number, _device, to_host, endpoint = _HEAD.unpack_from(octets)
        if command == _UNLINK:
            (victim,) = struct.unpack_from(">I", octets, 20)
            del octets[:_HEADER_SIZE]
            self._unlink(number, victim)
            return True
        (length,) = struct.unpack_from(">i", octets, 24)
        size = _HEADER_SIZE + (0 if to_host else length)
        if len(octets) < size:
            return False
        setup, data = bytes(octets[40:48]), bytes(octets[48:size])
        del octets[:size]
        if endpoint == 0:
            answer = self._device.control(setup, data)
            if answer is None:
                self._answer(number, status=-_EPIPE)
            else:
                self._answer(number, answer[:length] if to_host else b"", length=None if to_host else length)
        elif to_host:
            self._waiting[endpoint].append((number, length))
            self.feed(endpoint)
        else:
            self._device.out(data, lambda: self._answer(number, length=length))
        return True

    def _unlink(self, number: int, victim: int) -> None:
        status = 0
        for waiting in self._waiting.values():
            for transfer in [one for one in waiting if one[0] == victim]:
                waiting.remove(transfer)
                status = -_ECONNRESET
        self._send(_HEAD.pack(_UNLINKED, number, 0, 0, 0) + struct.pack(">i24x", status))

    def _answer(self, number: int, octets: bytes = b"", *, status: int = 0, length: int | None = None) -> None:
        count = len(octets) if length is None else length
        self._send(_HEAD.pack(_SUBMITTED, number, 0, 0, 0) + struct.pack(">5i8x", status, count, 0, 0, 0) + octets)

    def _send(self, octets: bytes) -> None:
        if self._socket is not None:
            self._socket.sendall(octets)
