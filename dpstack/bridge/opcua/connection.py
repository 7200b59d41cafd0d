"""Connections of the OPC UA server: octets, handshakes, unread answers and processor time of clients are bounded.

asyncua 2.1 opens sessions over a channel without security, keeps whatever a client sends and whatever it does not read,
and cuts answers into parts as small as a client wishes. The classes here refuse that.
"""

from __future__ import annotations

import asyncio
import contextlib
import socket
import time
from collections.abc import Sequence
from datetime import datetime
from typing import Any, Final

from asyncua import Server, ua
from asyncua.common.utils import Buffer, ServiceError
from asyncua.crypto.security_policies import SecurityPolicyNone
from asyncua.server.binary_server_asyncio import BinaryServer, OPCUAProtocol
from asyncua.server.internal_session import SessionState
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import header_from_binary, nodeid_from_binary, struct_from_binary, uatcp_to_binary

from dpstack.bridge.opcua.certificate import CLIENT_FAULTS, is_of_application
from dpstack.bridge.opcua.decoding import READS, READS_BEFORE_SESSION, Octets
from dpstack.bridge.opcua.lateness import LATE_S, Lateness
from dpstack.bridge.opcua.sessions import MOST_OPERATIONS, LimitedServer, digest

#: octets of a request, of one before a session is active, and of answers that a client has not read
MOST_REQUEST: Final = 1 << 20
MOST_UNREAD: Final = 4 << 20
_CHUNK: Final = 65_535
#: octets of a chunk that a client must take at least (Part 6, 7.1.2.3)
_LEAST_CHUNK: Final = 8192
#: encrypted octets of an OpenSecureChannel, and of a password: each 256 take the private key a millisecond
MOST_SEALED: Final = 2048
#: connections of one address: another computer finds room when this one takes what it gets
MOST_OF_ADDRESS: Final = 16
#: requests with orders that one connection has carried out at a time, and how many of them may be long; those beyond
#: hold up what comes behind them, also a stop
_MOST_ORDERS: Final = 40
_MOST_LONG: Final = 8
#: octets beyond which a request is long
_LONG: Final = 4096
_ID: Final = ua.ObjectIds
_S = ua.StatusCodes


def _ids(*names: str) -> frozenset[ua.NodeId]:
    return frozenset(ua.NodeId(getattr(_ID, f"{name}Request_Encoding_DefaultBinary")) for name in names)


_UNSECURED: Final = _ids("GetEndpoints", "FindServers")
_WITHOUT_USER: Final = _UNSECURED | _ids("CreateSession", "ActivateSession", "CloseSession")
_SERVICES: Final = _WITHOUT_USER | _ids(
    "CloseSecureChannel", "Read", "Write", "Call", "Browse", "TranslateBrowsePathsToNodeIds", "HistoryRead",
    "CreateSubscription", "ModifySubscription", "DeleteSubscriptions", "SetPublishingMode", "Publish", "Republish",
    "TransferSubscriptions", "CreateMonitoredItems", "ModifyMonitoredItems", "DeleteMonitoredItems",
    "SetMonitoringMode", "RegisterNodes", "UnregisterNodes",
)  # fmt: skip
[_CREATE] = _ids("CreateSession")
[_ACTIVATE] = _ids("ActivateSession")
#: they may take long, and must not hold up a stop that comes behind them over the same connection
_ORDERS: Final = _ids("Call", "Write")
_STARTS: Final = (b"HEL", b"OPN", b"MSG", b"CLO", b"ERR")


class Processor(UaProcessor):
    """Requests of one connection. Writes and calls are carried out beside the others."""

    iserver: LimitedServer

    def __init__(self, server: LimitedServer, transport: Any, limits: Any) -> None:
        super().__init__(server, transport, limits)
        self._orders: set[asyncio.Task[object]] = set()
        self._lateness = Lateness()
        self._hello = False

    @property
    def is_active(self) -> bool:
        return self.session is not None and self.session.is_activated()

    @property
    def address(self) -> str:
        return str((self.name or ("",))[0])

    def cut_off(self, why: str) -> None:
        """Close the connection without a farewell; counted and reported."""
        if not self._transport.is_closing():
            self.iserver.losses.cut_off(self.address, why)
        self._transport.abort()

    def end_with(self, code: int) -> None:
        """Send the reason and close the connection (Part 6, 7.1.2.5)."""
        status = ua.StatusCode(code)
        self._transport.write(uatcp_to_binary(ua.MessageType.Error, ua.ErrorMessage(status, status.doc)))
        self._transport.close()

    def send_response(
        self, requesthandle: Any, seqhdr: Any, response: Any, msgtype: Any = ua.MessageType.SecureMessage
    ) -> None:
        if self._transport.is_closing():
            return
        # also for messages of subscriptions, which come without a request of the moment
        if self._transport.get_write_buffer_size() > MOST_UNREAD:
            self.cut_off("did not read its answers")
            return
        super().send_response(requesthandle, seqhdr, response, msgtype)

    async def process(self, header: Any, body: Any) -> Any:
        kind = header.MessageType
        if kind == ua.MessageType.Hello:
            asked = struct_from_binary(ua.Hello, body.copy())
            if self._hello or min(asked.ReceiveBufferSize, asked.SendBufferSize) < _LEAST_CHUNK:
                raise ServiceError(_S.BadConnectionRejected)
            self._hello = True
        elif not self._hello or kind not in (
            ua.MessageType.SecureOpen, ua.MessageType.SecureMessage, ua.MessageType.SecureClose
        ):  # fmt: skip
            raise ServiceError(_S.BadTcpMessageTypeInvalid)
        elif kind == ua.MessageType.SecureOpen:
            sealed = body.copy(header.body_size)
            struct_from_binary(ua.AsymmetricAlgorithmHeader, sealed)
            if len(sealed) > MOST_SEALED:
                raise ServiceError(_S.BadTcpMessageTooLarge)
        elif not self.is_active and header.ChunkType != ua.ChunkType.Single:
            raise ServiceError(_S.BadTcpMessageTooLarge)
        result = await super().process(header, body)
        if kind == ua.MessageType.Hello:
            # a client of asyncua takes the limit that it was given for one of answers, too: so it was given more
            self._limits.max_message_size = MOST_REQUEST
            self._limits.max_chunk_count = MOST_REQUEST // _CHUNK + 1
        return result

    def open_secure_channel(self, algohdr: Any, seqhdr: Any, body: Any) -> None:
        if algohdr.SenderCertificate:
            fault = self.iserver.refuses(algohdr.SenderCertificate)
            if fault is not None:
                self.iserver.losses.cut_off(self.address, CLIENT_FAULTS.get(fault, "showed a bad certificate"))
                self.end_with(fault)
                return
        super().open_secure_channel(algohdr, seqhdr, Octets(bytes(body), READS_BEFORE_SESSION))

    async def process_message(self, seqhdr: Any, body: Any) -> Any:
        body = Octets(bytes(body), READS if self.is_active else READS_BEFORE_SESSION)
        most = _MOST_LONG if len(body) > _LONG else _MOST_ORDERS
        if nodeid_from_binary(body.copy()) in _ORDERS and len(self._orders) < most:
            task = asyncio.create_task(super().process_message(seqhdr, body))
            self._orders.add(task)
            task.add_done_callback(self._ordered)
            return True
        return await super().process_message(seqhdr, body)

    def _ordered(self, task: asyncio.Task[object]) -> None:
        self._orders.discard(task)
        if not task.cancelled():
            task.exception()  # the connection is gone

    async def _process_message(self, typeid: Any, requesthdr: Any, seqhdr: Any, body: Any) -> Any:
        if typeid not in _SERVICES:
            raise ServiceError(_S.BadServiceUnsupported)
        if isinstance(self._connection.security_policy, SecurityPolicyNone) and typeid not in _UNSECURED:
            raise ServiceError(_S.BadSecurityPolicyRejected)
        if typeid not in _WITHOUT_USER and not self.is_active:
            raise ServiceError(_S.BadSessionNotActivated)
        if typeid == _CREATE:
            if self.session is not None and self.session.state is not SessionState.Closed:
                # asyncua would keep the session before, which is not active, for ever
                raise ServiceError(_S.BadTooManySessions)
            self._judge_application(body.copy())
        LATE_S.set(self._lateness.of(requesthdr.Timestamp, asyncio.get_running_loop().time()))
        if typeid == _ACTIVATE:
            await self._verify(requesthdr, body.copy())
        return await super()._process_message(typeid, requesthdr, seqhdr, body)

    def _judge_application(self, body: Buffer) -> None:
        """The name by which a client shows itself must be that of its certificate."""
        client = struct_from_binary(ua.CreateSessionParameters, body).ClientDescription
        shown = self._connection.security_policy.peer_certificate or b""
        if not is_of_application(shown, client.ApplicationUri):
            raise ServiceError(_S.BadCertificateUriInvalid)

    async def _verify(self, requesthdr: Any, body: Buffer) -> None:
        """Look at a password in a thread, as that takes long; the user manager of the server finds the result."""
        params = struct_from_binary(ua.ActivateSessionParameters, body)
        token, users = params.UserIdentityToken, self.iserver.users
        session = self.session or self.iserver.lookup_external_session(requesthdr.AuthenticationToken)
        if not isinstance(token, ua.UserNameIdentityToken):
            return
        if len(token.Password or b"") > MOST_SEALED:
            raise ServiceError(_S.BadIdentityTokenInvalid)
        if session is None or users is None:
            return
        try:
            name, password = self.iserver.decrypt_user_token(session, token)
        except Exception:
            raise ServiceError(_S.BadIdentityTokenInvalid) from None
        if not isinstance(name, str) or not isinstance(password, str):
            raise ServiceError(_S.BadIdentityTokenInvalid)
        account = await users.verify(name, password, self.address)
        if account is not None:
            self.iserver.verified[name, digest(password)] = account
        else:
            self.iserver.losses.cut_off(self.address, "gave a wrong user or password")

    async def close(self) -> None:
        for task in tuple(self._orders):
            task.cancel()
        await super().close()


class ClientConnection(OPCUAProtocol):
    """A connection whose octets and answers are bounded."""

    processor: UaProcessor | None
    _buffer: bytes

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(self.iserver, LimitedServer)
        address = (transport.get_extra_info("peername") or ("",))[0]
        if sum((one.peer_name or ("",))[0] == address for one in self.clients) >= MOST_OF_ADDRESS:
            self.iserver.losses.cut_off(str(address), f"had {MOST_OF_ADDRESS} connections already")
            assert isinstance(transport, asyncio.Transport)
            transport.abort()
            return
        super().connection_made(transport)
        if self.processor is not None and self.transport is not None:
            self.processor = Processor(self.iserver, self.transport, self.limits)
            self.processor.set_policies(self.policies)

    async def _activation_watchdog(self) -> None:
        """Cut off a connection without an active session: at its begin, and some time after one has ended."""
        was_active = False
        while self.transport is not None and not self.transport.is_closing():
            await asyncio.sleep(self.iserver.max_pending_activation_seconds)
            if not isinstance(self.processor, Processor):
                return
            if not self.processor.is_active and not was_active:
                self.processor.cut_off("had no session")
            was_active = self.processor.is_active

    def data_received(self, data: bytes) -> None:
        if self.transport is None or self.transport.is_closing():
            return
        octets = self._buffer + data
        at = 0
        while len(octets) - at >= 8:
            size = int.from_bytes(octets[at + 4 : at + 8], "little")
            # with the channel and one octet more
            least = 8 if octets[at : at + 3] in (b"HEL", b"ERR") else 12
            if octets[at : at + 3] not in _STARTS or not least < size <= _CHUNK:
                self._cut_off("sent garbage")
                return
            if len(octets) - at < size:
                break
            # its own octets: a message that waits would hold those behind it, too
            body = Octets(octets[at : at + size], READS)  # of its headers; what it holds is bounded when it is whole
            try:
                self.messages.put_nowait((header_from_binary(body), body))
            except asyncio.QueueFull:
                self._cut_off("sent too many requests at once")
                return
            except Exception:
                self._cut_off("sent garbage")
                return
            at += size
        self._buffer = octets[at:]
        if len(self._buffer) >= 3 and self._buffer[:3] not in _STARTS:
            self._cut_off("sent garbage")

    def _cut_off(self, why: str) -> None:
        self._buffer = b""
        if isinstance(self.processor, Processor):
            self.processor.cut_off(why)

    async def _process_one_msg(self, header: Any, buf: Any) -> bool:
        assert isinstance(self.iserver, LimitedServer)
        await self.iserver.pace.turn()
        transport = self.transport
        if transport is None or transport.is_closing():
            return False
        if transport.get_write_buffer_size() > MOST_UNREAD:
            self._cut_off("did not read its answers")
            return False
        begun = time.thread_time()
        try:
            return await super()._process_one_msg(header, buf)
        except asyncio.CancelledError:
            raise
        except Exception as error:  # a chunk that cannot be decrypted or parsed ends its connection
            code = getattr(error, "code", None) or _S.BadTcpMessageTypeInvalid
            if isinstance(self.processor, Processor) and not transport.is_closing():
                self.processor.end_with(code)
            return False
        finally:
            self.iserver.pace.spent(time.thread_time() - begun)


class Listener(BinaryServer):
    """Serves sockets that are bound already."""

    def __init__(self, server: LimitedServer, listening: Sequence[socket.socket], limits: Any) -> None:
        host, port = listening[0].getsockname()[:2]
        super().__init__(server, host, port, limits)
        self._listening = listening

    def _make_protocol(self) -> OPCUAProtocol:
        return ClientConnection(self.iserver, self._policies, self.clients, self.closing_tasks, self.limits)

    async def start(self) -> None:
        loop = asyncio.get_running_loop()
        self._servers = [await loop.create_server(self._make_protocol, sock=one) for one in self._listening]
        self.cleanup_task = asyncio.create_task(self._close_task_loop())

    async def stop(self) -> None:
        for one in self._servers:
            one.close()
        await super().stop()


class PlantServer(Server):
    """The server as a whole. :meth:`start_on` serves sockets; ``now`` gives the time of ``CurrentTime``."""

    def __init__(self, server: LimitedServer, url: str, uri: str, name: str) -> None:
        super().__init__(iserver=server)
        self.set_endpoint(url)
        self._application_uri = uri
        self.set_server_name(name)
        self.product_uri = "urn:dpstack"
        self.manufacturer_name = "dpstack"
        self.application_type = ua.ApplicationType.Server
        self.set_security_policy([ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt])
        self.limits.max_message_size = MOST_UNREAD
        self.limits.max_chunk_count = MOST_UNREAD // _CHUNK + 1

    async def start_on(self, listening: Sequence[socket.socket]) -> None:
        await self._setup_server_nodes()
        await self.iserver.start()
        assert isinstance(self.iserver, LimitedServer)
        await self._show_limits()
        self.bserver = Listener(self.iserver, listening, self.limits)
        self.bserver.set_policies(self._policies)
        await self.bserver.start()

    async def _show_limits(self) -> None:
        """A client that reads them cuts its requests itself (Part 5, 6.3.11)."""
        for name in ("Read", "Write", "Browse", "MethodCall", "TranslateBrowsePathsToNodeIds"):
            node = ua.NodeId(getattr(_ID, f"Server_ServerCapabilities_OperationLimits_MaxNodesPer{name}"))
            most = 100 if name == "Browse" else MOST_OPERATIONS
            shown = ua.DataValue(ua.Variant(most, ua.VariantType.UInt32))
            await self.iserver.aspace.write_attribute_value(node, ua.AttributeIds.Value, shown)

    async def show_time(self, now: datetime) -> None:
        """Write CurrentTime; a client that sees it stand still knows that this program does not run."""
        await self.iserver.current_time_node.write_value(now)

    async def end(self) -> None:
        with contextlib.suppress(Exception):
            await self.stop()
