"""A connection to a broker with aiomqtt: its limits, errors and end, for a gateway and for ``dpstack fleet``."""

from __future__ import annotations

import asyncio
import logging
import re
import ssl
from collections.abc import Callable, Iterable
from typing import Final

import aiomqtt
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.packettypes import PacketTypes
from paho.mqtt.properties import Properties
from paho.mqtt.reasoncodes import ReasonCode

from dpstack.bridge.mqtt.broker import Broker
from dpstack.bridge.mqtt.limited_client import MOST_PACKET, LimitedClient
from dpstack.bridge.mqtt.plant_node import Publish
from dpstack.bridge.mqtt.worker_thread import in_thread

#: s for the TCP connection with TLS, and for each answer of the broker
CONNECT_S: Final = 5.0
ANSWER_S: Final = 5.0
#: s until the next try: the first, and the longest
FIRST_RETRY_S: Final = 1.0
LONGEST_RETRY_S: Final = 30.0
#: messages that wait to be read
MOST_WAITING: Final = 100
#: user property of a will: the number of its session
_SESSION: Final = "session"
_MOST_DIGITS: Final = 9
#: reason code of MQTT 5 (2.4)
_DISCONNECT_WITH_WILL: Final = 0x04
_UNSPECIFIED: Final = 0x80
#: the same (3.2.2.2): bad user name or password, not authorized, bad authentication method
_REFUSED: Final = frozenset({0x86, 0x87, 0x8C})
#: codes of OpenSSL for a certificate: not valid yet, expired
_DATES: Final = frozenset({9, 10})
_SEE_CERTIFICATE: Final = "see url (its host) and ca (who signed it)"
#: alerts of TLS in the words of OpenSSL: the broker judges the certificate of this program
_ALERTS: Final = (
    ("ALERT_CERTIFICATE_REQUIRED", "it wants a certificate of this program: give cert and key"),
    (
        "ALERT_CERTIFICATE_EXPIRED",
        "it refuses the certificate of this program: it has expired; give a new cert and key",
    ),
    (
        "ALERT_UNKNOWN_CA",
        "it does not know who signed the certificate of this program: see cert and key",
    ),
    ("ALERT_BAD_CERTIFICATE", "it refuses the certificate of this program: see cert"),
    ("ALERT_CERTIFICATE_UNKNOWN", "it refuses the certificate of this program: see cert"),
)
#: in front of a reason that paho logs
_PAHO: Final = re.compile(r"^failed to receive on socket: (\[Errno \d+\] )?")
#: texts of a connection to a port that expects TLS, or does not
_WRONG_PORT: Final = ("Connection reset", "WRONG_VERSION_NUMBER", "wrong version number", "RECORD_LAYER_FAILURE")


class Inbox(asyncio.Queue[aiomqtt.Message]):
    """Messages that wait to be read. One for which there is no room is counted."""

    lost = 0

    def put_nowait(self, item: aiomqtt.Message) -> None:
        if self.full():
            self.lost += 1
        else:
            super().put_nowait(item)


class LastError(logging.Handler):
    """Keeps the last error that the library logs. For some lost sockets it is the only reason there is: for instance, a
    broker says after the handshake that the certificate of this program has expired."""

    text = ""

    def emit(self, record: logging.LogRecord) -> None:
        self.text = record.getMessage()


def make_client(
    broker: Broker,
    tls: ssl.SSLContext | None,
    errors: logging.Handler,
    client_id: str,
    *,
    most_waiting: int = MOST_WAITING,
    will: Publish | None = None,
) -> LimitedClient:
    """A client that is not connected yet. ``most_waiting``: messages that may wait to be read."""
    properties = Properties(PacketTypes.CONNECT)  # type: ignore[no-untyped-call]
    properties.SessionExpiryInterval = 0
    properties.ReceiveMaximum = MOST_WAITING
    properties.MaximumPacketSize = MOST_PACKET
    # its own log is for its authors; errors are reported
    logger = logging.Logger("dpstack mqtt", logging.ERROR)
    logger.addHandler(errors)
    client = LimitedClient(
        broker.host,
        broker.port,
        username=broker.user or None,
        password=broker.password or None,
        logger=logger,
        identifier=client_id,
        queue_type=Inbox,
        protocol=aiomqtt.ProtocolVersion.V5,
        will=None if will is None else _will(will),
        timeout=ANSWER_S,
        keepalive=broker.keepalive_s,
        clean_start=True,
        max_queued_incoming_messages=most_waiting,
        properties=properties,
        tls_context=tls,
    )
    client._client.connect_timeout = CONNECT_S
    return client


def _will(will: Publish) -> aiomqtt.Will:
    properties = None
    if will.session is not None:
        properties = Properties(PacketTypes.WILLMESSAGE)  # type: ignore[no-untyped-call]
        properties.UserProperty = (_SESSION, str(will.session))
    return aiomqtt.Will(will.topic, will.payload, will.qos, will.retain, properties)


def session_of(message: aiomqtt.Message) -> int | None:
    """The number of the session whose will ``message`` is; None if it has none that :func:`make_client` gives."""
    for name, text in getattr(message.properties, "UserProperty", ()):
        if name == _SESSION and len(text) <= _MOST_DIGITS and text.isascii() and text.isdecimal():
            return int(text)
    return None


def cancellations() -> int:
    task = asyncio.current_task()
    return 0 if task is None else task.cancelling()


def end_if_cancelled(before: int) -> None:
    """Raise a cancellation since ``before`` that nobody has seen, else the connector would never end:
    ``asyncio.wait_for``, which aiomqtt uses, swallows one that comes when its future is just done (Python before
    3.12)."""
    if cancellations() > before:
        raise asyncio.CancelledError


async def connect(client: LimitedClient) -> None:
    """Connect. TCP and TLS block a thread: a cancellation leaves it alone, and closes later what it opens."""
    connecting = asyncio.ensure_future(in_thread("dpstack mqtt: connecting", client.connect_blocking))
    try:
        await asyncio.shield(connecting)
    except asyncio.CancelledError:
        connecting.add_done_callback(lambda _: connecting.cancelled() or connecting.exception())
        connecting.add_done_callback(lambda _: client._client._sock_close())
        raise
    except OSError as error:
        raise aiomqtt.MqttError(str(error)) from None
    await client.wait_connected()


async def subscribe(client: LimitedClient, topics: Iterable[str], qos: int) -> None:
    """Subscribe. Raises MqttError if the broker refuses a topic, or does not answer in time."""
    for topic in topics:
        for code in await client.subscribe(topic, qos=qos):
            if isinstance(code, ReasonCode) and code.is_failure:
                raise aiomqtt.MqttError(f"it refuses the subscription of {topic}: {code}")


async def close(client: aiomqtt.Client) -> None:
    """End a connection, whatever its state: DISCONNECT with "Disconnect with Will Message" if it still works
    (tck-id-payloads-ndeath-will-message-publisher-disconnect-mqtt50), then the socket."""
    paho, gone = client._client, client._disconnected
    code = None
    if not gone.done() and paho.is_connected():
        code = ReasonCode(PacketTypes.DISCONNECT, identifier=_DISCONNECT_WITH_WILL)
    try:
        if code is not None and paho.disconnect(code) == MQTTErrorCode.MQTT_ERR_SUCCESS:
            await asyncio.wait((gone,), timeout=1.0)
    finally:
        paho._sock_close()
        for future in (gone, client._connected):
            if future.done() and not future.cancelled():
                future.exception()  # asyncio reports one that nobody has asked for


def retry_s(first_s: float, failed: int) -> float:
    """s until the next try, as ``failed`` connections one after the other have failed: ``first_s``, doubled with each,
    at most :data:`LONGEST_RETRY_S`."""
    return min(first_s * 2.0 ** min(failed, 10), LONGEST_RETRY_S)


def spread(seconds: float, draw: Callable[[], float]) -> float:
    """``seconds``, up to half longer or shorter, so that a thousand programs do not come back together. ``draw``: draws
    numbers from 0 to 1."""
    return seconds * (0.5 + draw())


def is_refused(error: BaseException) -> bool:
    """Whether the broker has refused user or password."""
    code = getattr(error, "rc", None)
    return isinstance(code, ReasonCode) and code.value in _REFUSED


def why_lost(error: BaseException, last: LastError, *, connected: bool) -> str:
    """The reason of an error of the connection, with a remedy if there is one. ``connected``: whether the broker had
    accepted the connection."""
    for alert, text in _ALERTS:
        if alert in last.text:
            return text
    text = _PAHO.sub("", last.text) or text_of(error)
    if connected:
        return text
    if is_refused(error):
        return f"it refuses user or password ({text})"
    if any(reason in text for reason in _WRONG_PORT):
        return f"{text}; is that its port? (mqtts:// is with TLS, mqtt:// without)"
    return text


def text_of(error: BaseException) -> str:
    """The reason of an error of the connection; a text of the libraries, which hold no secrets."""
    cause = error.__cause__ if isinstance(error.__cause__, Exception) else error
    hidden = error.__context__ if isinstance(error, aiomqtt.MqttError) else None
    if cause is error and isinstance(hidden, OSError) and hidden.strerror:
        cause = hidden  # aiomqtt takes its text only, "from None"
    code = getattr(cause, "rc", None)
    if isinstance(code, ReasonCode):
        # paho's code for a socket that was closed without a word
        return "it has ended the connection, or the network has" if code.value == _UNSPECIFIED else str(code)
    if isinstance(cause, ssl.SSLCertVerificationError):
        dates = getattr(cause, "verify_code", None) in _DATES
        see = "give the broker a new one, or set the clock of this computer" if dates else _SEE_CERTIFICATE
        return f"its certificate is refused ({cause.verify_message}); {see}"
    return (isinstance(cause, OSError) and cause.strerror) or str(cause) or type(error).__name__
