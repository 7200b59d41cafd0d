"""Writes dpstack/bridge/opcua/standard_nodes.bin: the standard nodes of OPC UA (Part 5) that a plant needs, 1200 of the
6200 that asyncua has, as OPC UA itself encodes them. A test holds the file to the asyncua that is installed."""

from __future__ import annotations

import zlib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import Final

from asyncua import ua
from asyncua.server.standard_address_space import standard_address_space_services as standard
from asyncua.ua.ua_binary import struct_to_binary

from dpstack.bridge.opcua.standard_nodes import COUNT, FILE

_I: Final = ua.ObjectIds
#: types that the plant's nodes and events are instances of, or that clients look for; their parts come with them
_TYPES: Final = (
    _I.BaseObjectType, _I.FolderType, _I.BaseDataVariableType, _I.PropertyType, _I.BaseAnalogType, _I.AnalogItemType,
    _I.AnalogUnitType, _I.AnalogUnitRangeType, _I.DiscreteItemType, _I.TwoStateDiscreteType, _I.MultiStateDiscreteType,
    _I.FiniteStateMachineType, _I.FiniteStateVariableType, _I.StateType, _I.InitialStateType, _I.TransitionType,
    _I.BaseEventType, _I.SystemEventType, _I.RefreshStartEventType, _I.RefreshEndEventType,
    _I.RefreshRequiredEventType, _I.BaseModelChangeEventType, _I.GeneralModelChangeEventType, _I.ConditionType,
    _I.AcknowledgeableConditionType, _I.AlarmConditionType, _I.DiscreteAlarmType, _I.OffNormalAlarmType,
    _I.TwoStateVariableType, _I.ConditionVariableType, _I.EventQueueOverflowEventType, _I.AuditEventType,
    _I.ModellingRule_Mandatory, _I.ModellingRule_Optional, _I.ModellingRule_ExposesItsArray,
    _I.ModellingRule_OptionalPlaceholder, _I.ModellingRule_MandatoryPlaceholder, _I.HistoricalDataConfigurationType,
    _I.Argument, _I.EUInformation, _I.Range, _I.EnumValueType, _I.Server, _I.RootFolder, _I.ObjectsFolder,
    _I.TypesFolder, _I.ViewsFolder, _I.EventTypesFolder, _I.ObjectTypesFolder, _I.VariableTypesFolder,
    _I.DataTypesFolder, _I.ReferenceTypesFolder, _I.LocationsFolder if hasattr(_I, "LocationsFolder") else _I.Server,
)  # fmt: skip
#: components of the Server object for services that are not there
_WITHOUT: Final = frozenset(
    (_I.PublishSubscribe, _I.ServerConfiguration, _I.Server_ServerCapabilities_RoleSet)
)  # fmt: skip
_PARTS: Final = frozenset((_I.HasComponent, _I.HasOrderedComponent, _I.HasProperty, _I.HasEncoding))


class _Collected:
    """Collects the nodes that the functions of asyncua would add."""

    def __init__(self) -> None:
        self.nodes: dict[ua.NodeId, ua.AddNodesItem] = {}
        self.references: list[ua.AddReferencesItem] = []

    def add_nodes(self, nodes: Iterable[ua.AddNodesItem]) -> None:
        for one in nodes:
            self.nodes[one.RequestedNewNodeId] = one

    def add_references(self, references: Iterable[ua.AddReferencesItem]) -> None:
        self.references += references


def standard_nodes() -> tuple[list[ua.AddNodesItem], list[ua.AddReferencesItem]]:
    """The nodes, each behind its parent and its type, and the references between them."""
    given = _Collected()
    for name in sorted(name for name in vars(standard) if name.startswith("create_standard_address_space_Services_")):
        getattr(standard, name)(given)
    nodes = [given.nodes[id_] for id_ in _ordered(given.nodes)]
    kept = {one.RequestedNewNodeId for one in nodes}
    return nodes, [one for one in given.references if one.SourceNodeId in kept and one.TargetNodeId in kept]


def render() -> bytes:
    """The octets of the file before they are compressed: number of nodes, nodes, number of references, references."""
    nodes, references = standard_nodes()
    out = bytearray()
    for items in ([_encodable(one) for one in nodes], references):
        out += COUNT.pack(len(items)) + b"".join(map(struct_to_binary, items))
    return bytes(out)


def _encodable(item: ua.AddNodesItem) -> ua.AddNodesItem:
    """asyncua gives a few values as lists, for which OPC UA has no encoding, instead of as variants."""
    value = getattr(item.NodeAttributes, "Value", None)
    if not isinstance(value, list):
        return item
    return replace(item, NodeAttributes=replace(item.NodeAttributes, Value=ua.Variant(value)))


def _ordered(nodes: dict[ua.NodeId, ua.AddNodesItem]) -> list[ua.NodeId]:
    """The nodes that are kept, each behind its parent and its type."""
    parts: defaultdict[ua.NodeId, list[ua.NodeId]] = defaultdict(list)
    for id_, one in nodes.items():
        if one.ReferenceTypeId.Identifier in _PARTS and id_.Identifier not in _WITHOUT:
            parts[one.ParentNodeId].append(id_)
    every_type = (id_ for id_, one in nodes.items() if one.NodeClass == ua.NodeClass.ReferenceType)
    wait = [*every_type, *(ua.NodeId(one) for one in _TYPES)]
    kept: set[ua.NodeId] = set()
    while wait:
        id_ = wait.pop()
        if id_ in kept or id_ not in nodes:
            continue
        kept.add(id_)
        wait += parts[id_]
        wait += _needs(nodes[id_])
    found: dict[ua.NodeId, None] = {}
    for id_ in sorted(kept, key=lambda one: int(one.Identifier)):
        way = [id_]
        while way:  # parents and types first
            before = [one for one in _before(nodes[way[-1]]) if one in kept and one not in found and one not in way]
            if before:
                way.append(before[0])
            else:
                found[way.pop()] = None
    return list(found)


def _before(item: ua.AddNodesItem) -> Iterator[ua.NodeId]:
    yield item.ParentNodeId
    yield item.TypeDefinition


def _needs(item: ua.AddNodesItem) -> Iterator[ua.NodeId]:
    yield from _before(item)
    yield item.ReferenceTypeId
    data_type = getattr(item.NodeAttributes, "DataType", None)
    if isinstance(data_type, ua.NodeId):
        yield data_type


if __name__ == "__main__":
    FILE.write_bytes(zlib.compress(render(), 9))
