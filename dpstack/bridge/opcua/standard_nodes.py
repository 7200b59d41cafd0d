"""The standard nodes of OPC UA (Part 5) that a plant needs: 1200 of the 6200 that asyncua has."""

from __future__ import annotations

import asyncio
import gc
from collections import defaultdict
from collections.abc import Iterable, Iterator
from typing import Any, Final

from asyncua import ua
from asyncua.server.standard_address_space import standard_address_space_services as standard

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
#: nodes that are added before others have their turn
_AT_ONCE: Final = 50


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


async def add_standard_nodes(service: Any) -> None:
    """Add them by the NodeManagementService of a server. Others have their turn every few milliseconds."""
    collects = gc.isenabled()
    gc.disable()  # the nodes stay: to look for garbage among them takes half of this time
    try:
        await _add_nodes(service)
    finally:
        if collects:
            gc.enable()


async def _add_nodes(service: Any) -> None:
    given = _Collected()
    for name in sorted(name for name in vars(standard) if name.startswith("create_standard_address_space_Services_")):
        getattr(standard, name)(given)
        await asyncio.sleep(0)
    nodes = [given.nodes[id_] for id_ in _ordered(given.nodes)]
    kept = {one.RequestedNewNodeId for one in nodes}
    for at in range(0, len(nodes), _AT_ONCE):
        tuple(service.try_add_nodes(nodes[at : at + _AT_ONCE], check=False))
        await asyncio.sleep(0)
    references = [one for one in given.references if one.SourceNodeId in kept and one.TargetNodeId in kept]
    for at in range(0, len(references), 2 * _AT_ONCE):
        tuple(service.try_add_references(references[at : at + 2 * _AT_ONCE]))
        await asyncio.sleep(0)


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
