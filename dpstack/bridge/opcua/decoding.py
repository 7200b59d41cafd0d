"""A bound for what asyncua decodes of a client's octets: reads, nesting, lengths, types of structures.

asyncua 2.1 believes every length: an array of 2^31-1 values without octets, a text of length -4 that steps back over
its own length, a matrix of a million empty lists, structures in structures. :class:`Octets` is a buffer of asyncua that
refuses these. Four functions of ``asyncua.ua.ua_binary`` are replaced; for other buffers they do what they did.
"""

from __future__ import annotations

from typing import Any, Final

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua import ua_binary

from dpstack.errors import DpError

#: reads of a request before a session is active; each costs about two microseconds
READS_BEFORE_SESSION: Final = 500
#: reads of a request of a session: 1000 monitored items with filters need 22 000
READS: Final = 30_000
#: octets of one read that count as a read more
_OCTETS: Final = 64
#: structures and variants within each other
DEEPEST: Final = 32
_ID: Final = ua.ObjectIds
#: structures that a request may hold as ExtensionObject: identities, filters and their operands, details of history.
#: Others stay octets: some have flags, of which Python keeps each combination for ever
_STRUCTURES: Final = frozenset(
    ua.NodeId(one)
    for one in (
        _ID.AnonymousIdentityToken_Encoding_DefaultBinary, _ID.UserNameIdentityToken_Encoding_DefaultBinary,
        _ID.X509IdentityToken_Encoding_DefaultBinary, _ID.IssuedIdentityToken_Encoding_DefaultBinary,
        _ID.DataChangeFilter_Encoding_DefaultBinary, _ID.EventFilter_Encoding_DefaultBinary,
        _ID.AggregateFilter_Encoding_DefaultBinary, _ID.ElementOperand_Encoding_DefaultBinary,
        _ID.LiteralOperand_Encoding_DefaultBinary, _ID.AttributeOperand_Encoding_DefaultBinary,
        _ID.SimpleAttributeOperand_Encoding_DefaultBinary, _ID.ReadRawModifiedDetails_Encoding_DefaultBinary,
        _ID.ReadEventDetails_Encoding_DefaultBinary, _ID.ReadProcessedDetails_Encoding_DefaultBinary,
        _ID.ReadAtTimeDetails_Encoding_DefaultBinary,
    )
)  # fmt: skip
_REPLACED: Final = ("extensionobject_from_binary", "variant_from_binary")
_CACHES: Final = (
    "_create_uatype_deserializer", "_create_uatype_array_deserializer", "_create_list_deserializer",
    "_create_type_deserializer", "_create_dataclass_deserializer",
)  # fmt: skip
_DIAGNOSTIC_INFO: Final = 25


class Octets(Buffer):
    """Octets of a client, of which ``reads`` parts may be read. Raises UaStatusCodeError (BadDecodingError, or
    BadEncodingLimitsExceeded)."""

    _data: bytes
    _cur_pos: int
    _size: int

    def __init__(self, data: bytes, reads: int) -> None:
        super().__init__(data)
        #: reads that are left, and the depth; copies share it
        self._left = [reads, 0]

    def read(self, size: int) -> bytes:
        if not 0 <= size <= self._size:
            raise ua.UaStatusCodeError(ua.StatusCodes.BadDecodingError)
        left = self._left
        left[0] -= 1 + size // _OCTETS
        if left[0] < 0:
            raise ua.UaStatusCodeError(ua.StatusCodes.BadEncodingLimitsExceeded)
        at = self._cur_pos
        self._size -= size
        self._cur_pos = at + size
        return self._data[at : at + size]

    def skip(self, size: int) -> None:
        if not 0 <= size <= self._size:
            raise ua.UaStatusCodeError(ua.StatusCodes.BadDecodingError)
        super().skip(size)

    def copy(self, size: int = -1) -> Octets:
        made = Octets.__new__(Octets)
        part = super().copy(size)
        made._data, made._cur_pos, made._size, made._left = part._data, part._cur_pos, part._size, self._left
        return made

    def enter(self) -> None:
        self._left[1] += 1
        if self._left[1] > DEEPEST:
            raise ua.UaStatusCodeError(ua.StatusCodes.BadEncodingLimitsExceeded)

    def leave(self) -> None:
        self._left[1] -= 1


def guard() -> None:
    """Put the bounds into asyncua, once for the process. Raises DpError if this asyncua has other parts."""
    if getattr(ua_binary.extensionobject_from_binary, "guarded", False):
        return
    missing = [
        name for name in (*_REPLACED, *_CACHES, "Primitives", "nodeid_from_binary") if not hasattr(ua_binary, name)
    ]
    missing += [name for name in _CACHES if not hasattr(getattr(ua_binary, name, None), "cache_clear")]
    missing += [] if hasattr(getattr(ua_binary.Primitives, "Null", None), "unpack") else ["Primitives.Null"]
    if missing:
        raise DpError(
            f"this version of asyncua has no {', '.join(dict.fromkeys(missing))}, without which its decoding cannot be "
            "bounded: install a version that dpstack[opcua] allows"
        )
    structure, variant = ua_binary.extensionobject_from_binary, ua_binary.variant_from_binary

    def bounded_structure(data: Any) -> Any:
        if not isinstance(data, Octets):
            return structure(data)
        data.enter()
        type_ = ua_binary.nodeid_from_binary(data.copy())
        if type_ in _STRUCTURES or type_.Identifier == 0:
            found = structure(data)
        else:
            ua_binary.nodeid_from_binary(data)
            body = ua_binary.Primitives.Bytes.unpack(data) if data.read(1)[0] & 1 else None
            found = ua.ExtensionObject(TypeId=type_, Body=body)
        data.leave()
        return found

    def bounded_variant(data: Any) -> Any:
        if not isinstance(data, Octets):
            return variant(data)
        data.enter()
        how = data.copy().read(1)[0]
        if how & 0x40 or how & 0x3F == _DIAGNOSTIC_INFO:  # a matrix, or texts about errors: no node takes one
            raise ua.UaStatusCodeError(ua.StatusCodes.BadDecodingError)
        found = variant(data)
        data.leave()
        return found

    def bounded_null(data: Any) -> None:
        if isinstance(data, Octets):
            data.read(0)

    bounded_structure.guarded = True  # type: ignore[attr-defined]
    ua_binary.extensionobject_from_binary = bounded_structure
    ua_binary.variant_from_binary = bounded_variant
    ua_binary.Primitives.Null = _Null(bounded_null)
    for name in _CACHES:
        getattr(ua_binary, name).cache_clear()  # functions that were made before hold those that are replaced


class _Null:
    """A value without octets, which counts as a read."""

    def __init__(self, unpack: Any) -> None:
        self.unpack = unpack

    def pack(self, data: object) -> bytes:
        return b""
