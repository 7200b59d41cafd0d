"""``LimitedClient``: an MQTT client that reads no faster than orders come from people, whatever its broker sends, and
sends at once, without a turn of the loop."""

from __future__ import annotations

import contextlib
import socket
import threading
from typing import Any, Final

import aiomqtt
from paho.mqtt.client import Client

from dpstack.bridge.mqtt.payload import MOST_OCTETS

#: octets of a packet; CONNECT gives the broker this limit
MOST_PACKET: Final = 2 * MOST_OCTETS
#: octets that are read in a second; s in which they are counted together
MOST_A_SECOND: Final = 2 << 20
_WINDOW_S: Final = 0.1
#: packets that wait for a broker which does not read, confirmations among them
_MOST_UNREAD: Final = 1000
#: octets for which a packet counts besides its own: the time to take it
_A_PACKET: Final = 1000


class LimitedClient(aiomqtt.Client):
    """Octets beyond :data:`MOST_A_SECOND` wait at the broker. A packet longer than :data:`MOST_PACKET` ends the
    connection before any of it is taken, and so does a message with QoS 2: subscriptions have QoS 1 at most. aiomqtt
    and paho-mqtt read up to 256 MB at once, without a pause, and keep 65535 messages with QoS 2."""

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._window_began = self._window_ends = 0.0
        self._read_in_window = 0
        self._thread = threading.get_ident()
        self._receive = self._client._sock_recv
        self._client._sock_recv = self._receive_limited  # type: ignore[method-assign,assignment]
        self._send = self._client._sock_send
        self._client._sock_send = self._send_or_say_why  # type: ignore[method-assign]

    # --- in place of ``async with``, which connects in a thread that the end of the program would wait for

    def connect_blocking(self) -> None:
        """Connect TCP and TLS, and send CONNECT. Raises OSError."""
        self._client_connect()

    async def wait_connected(self) -> None:
        """Wait for CONNACK. Raises MqttError if the broker refuses, ends the connection, or does not answer in time."""
        await self._wait_for(self._connected, timeout=None)

    def _on_disconnect(
        self, client: Client, userdata: Any, flags: Any, reason_code: Any, properties: Any = None
    ) -> None:
        """The connection is gone. aiomqtt passes over one that goes before CONNACK, and waits for it as long as for a
        silent broker."""
        if not self._connected.done():
            self._connected.set_exception(aiomqtt.MqttCodeError(reason_code, "the connection has ended"))
        super()._on_disconnect(client, userdata, flags, reason_code, properties)

    def _send_or_say_why(self, buf: bytes | bytearray) -> int:
        """A broker that refuses a certificate says so after the handshake (TLS 1.3), and ends the connection. If this
        is seen while CONNECT is sent, its reason still waits to be read."""
        try:
            return self._send(buf)
        except BlockingIOError:
            raise
        except OSError:
            with contextlib.suppress(BlockingIOError):
                self._receive(1)  # raises the reason
            raise

    def _receive_limited(self, octets: int) -> bytes:
        if octets > MOST_PACKET:
            # paho gives its text to the log, and ends the connection
            raise OSError(f"the broker sends a packet of {octets} octets, {MOST_PACKET} are allowed")
        found = self._receive(octets)
        self._read_in_window += len(found)
        return found

    # --- paho calls these, also in the thread that connects. In place of those of aiomqtt: they give the number of the
    # --- socket to the loop, which may be that of another file when its turn comes

    def _on_socket_open(self, client: Client, userdata: Any, sock: Any) -> None:
        self._loop.call_soon_threadsafe(self._begin, sock)

    def _on_socket_register_write(self, client: Client, userdata: Any, sock: Any) -> None:
        """paho has put a packet into its queue, which was empty. It is sent now: a turn of the loop would cost more
        than the sending."""
        if threading.get_ident() != self._thread or client._in_callback_mutex.locked():
            self._loop.call_soon_threadsafe(self._begin_writing, sock)
            return
        # The queue holds nothing else, so nobody awaits a callback yet: publish() sees that its message is gone.
        # Without the callback paho makes no reason code and properties for it, which take longer than the sending.
        # What stays in the queue is sent by the writer of the loop, with the callback.
        client._on_publish = None
        try:
            self._write()
        finally:
            client._on_publish = self._on_publish
        self._begin_writing(sock)

    def _is_open(self, sock: socket.socket) -> bool:
        return self._client.socket() is sock and not self._disconnected.done()

    def _begin(self, sock: socket.socket) -> None:
        if self._is_open(sock):
            self._misc_task = self._loop.create_task(self._misc_loop(), name="dpstack mqtt: keep alive")
            # else the second of two messages waits until the broker has confirmed the first one: 40 ms and more
            with contextlib.suppress(OSError):
                sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._begin_reading(sock)

    def _begin_reading(self, sock: socket.socket) -> None:
        if self._is_open(sock):
            self._loop.add_reader(sock.fileno(), self._read, sock)
            self._read(sock)  # with TLS octets may wait behind the socket

    def _begin_writing(self, sock: socket.socket) -> None:
        if self._is_open(sock) and self._client.want_write():
            self._loop.add_writer(sock.fileno(), self._write)

    def _write(self) -> None:
        try:
            self._client.loop_write()
        except Exception as error:  # as aiomqtt does it: the connection is broken
            self._break(error)

    def _read(self, sock: Any) -> None:
        """Take packets until there are no more, or until this part of a second has had its share."""
        now = self._loop.time()
        if now >= self._window_ends:
            self._window_began, self._window_ends, self._read_in_window = now, now + _WINDOW_S, 0
        try:
            while True:
                self._client.loop_read()
                self._read_in_window += _A_PACKET
                if len(self._client._out_packet) > _MOST_UNREAD:
                    raise OSError("the broker does not read what it is sent")
                if self._client._in_messages:
                    raise OSError("the broker sends a message with QoS 2, which nobody has subscribed")
                has_more = self._client.socket() is sock and bool(getattr(sock, "pending", int)())
                if self._read_in_window > MOST_A_SECOND * _WINDOW_S:
                    self._pause(sock)
                    return
                if not has_more:
                    return
        except Exception as error:  # as aiomqtt does it: the connection is broken
            self._break(error)
            if (still := self._client.socket()) is not None and still is sock:
                self._loop.remove_reader(still.fileno())

    def _break(self, error: Exception) -> None:
        if not self._disconnected.done():
            self._disconnected.set_exception(error)
        if not self._connected.done():
            self._connected.set_exception(error)

    def _pause(self, sock: socket.socket) -> None:
        if self._client.socket() is sock:
            self._window_ends = self._window_began + self._read_in_window / MOST_A_SECOND
            self._loop.remove_reader(sock.fileno())
            self._loop.call_at(self._window_ends, self._begin_reading, sock)
