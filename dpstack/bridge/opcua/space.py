"""The address space of OPC UA: types of buses, slaves and drives, and the nodes of a tree as their instances."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from typing import Any, Final

from asyncua import ua
from asyncua.server.internal_server import InternalServer

from dpstack.bridge.names import OPCUA_BROWSE, unique_names
from dpstack.plant.items import DrivePlant, PlanPlant, Plant, SlavePlant
from dpstack.plant.nodes import DRIVE_STATES, Described, Kind, Node, OfferedOrder, bus_of, slave_of
from dpstack.plant.quality import BOOL, BYTES, TEXT, Reading

NAMESPACE: Final = "urn:dpstack:plant"
_V = ua.VariantType
#: type of a node: variant type of OPC UA (Part 6, 5.1.2)
VARIANTS: Final[Mapping[str, ua.VariantType]] = {
    BOOL: _V.Boolean, TEXT: _V.String, BYTES: _V.ByteString, "f32": _V.Float, "f64": _V.Double,
    "u8": _V.Byte, "u16": _V.UInt16, "u32": _V.UInt32, "u64": _V.UInt64,
    "i8": _V.SByte, "i16": _V.Int16, "i32": _V.Int32, "i64": _V.Int64,
}  # fmt: skip
#: name of the method of each order of a drive
METHODS: Final[Mapping[str, str]] = {
    "start": "Start", "stop": "Stop", "quick_stop": "QuickStop", "coast": "Coast", "acknowledge": "Acknowledge",
    "speed": "SetSpeed",
}  # fmt: skip
#: process values: nodes that have the words for their status in a property
_WITH_REASON: Final = (Kind.VALUE, Kind.DRIVE)
#: nodes that are made, or removed, before others have their turn, some 0.15 ms each
_AT_ONCE: Final = 20
_READ: Final = 1 << ua.AccessLevel.CurrentRead | 1 << ua.AccessLevel.HistoryRead
_WRITE: Final = 1 << ua.AccessLevel.CurrentWrite
_TYPE_DEFINITION: Final = ua.NodeId(ua.ObjectIds.HasTypeDefinition)
#: classes of nodes that have a type
_INSTANCES: Final = (ua.NodeClass.Object, ua.NodeClass.Variable)


class SharedValue(ua.DataValue):
    """A value that nobody changes, so that asyncua need not copy it for each monitored item: most of a write's time."""

    def __deepcopy__(self, memo: object) -> SharedValue:
        return self


_NONE: Final = SharedValue(ua.Variant(), StatusCode=ua.StatusCode(ua.StatusCodes.BadWaitingForInitialData))


@dataclass(frozen=True, slots=True)
class _Built:
    described: Described
    name: str
    allowed: frozenset[str]
    nodes: tuple[ua.NodeId, ...]


class Space:
    """Nodes of ``server``, made from the tree. ``values``: tree node by NodeId; ``methods``: order by the NodeId of its
    method. ``names``: those of the bus and of the slaves, by address."""

    def __init__(self, server: InternalServer, index: int) -> None:
        self._server = server
        self._index = index
        self._built: dict[int | None, _Built] = {}
        #: nodes made since others had their turn
        self._made = 0
        #: the words for the status of process values, as shown last
        self._reasons: dict[ua.NodeId, str] = {}
        #: the last good state of each drive
        self._states: dict[str, str] = {}
        self.values: dict[ua.NodeId, Node] = {}
        self.methods: dict[ua.NodeId, tuple[ua.NodeId, OfferedOrder]] = {}
        self.names: dict[int | None, str] = {}

    def node(self, text: str) -> ua.NodeId:
        return ua.NodeId(text, self._index)

    def method(self, owner: ua.NodeId, method: ua.NodeId) -> tuple[ua.NodeId, OfferedOrder] | None:
        """The object and the order of a method, which a client names by its own NodeId or by that of the type (Part 4,
        5.12.2)."""
        word = str(method.Identifier).removeprefix("type/DriveType/")
        own = self.node(f"{owner.Identifier}/method/{word}")
        return self.methods.get(own if method == self.node(f"type/DriveType/{word}") else method)

    def add_types(self) -> None:
        """BusType, SlaveType, DriveType with their members, LastCommandType; DriveStateMachineType with its states. A
        transition comes when a drive makes it first."""
        base = ua.NodeId(ua.ObjectIds.BaseObjectType)
        for name in ("BusType", "SlaveType", "DriveType", "LastCommandType"):
            self._type(name, base)
        for word, name in METHODS.items():
            self._method(self.node(f"type/DriveType/{word}"), self.node("type/DriveType"), name, executable=False)
            self._rule(self.node(f"type/DriveType/{word}"), mandatory=False)
        self._type("DriveStateMachineType", ua.NodeId(ua.ObjectIds.FiniteStateMachineType))
        machine = self.node("type/DriveStateMachineType")
        for number, name in enumerate(DRIVE_STATES):
            state = self._object(f"state/{name}", machine, name, ua.NodeId(ua.ObjectIds.StateType))
            value = ua.Variant(number, _V.UInt32)
            self._variable(f"state/{name}/number", state, ua.QualifiedName("StateNumber", 0), _V.UInt32, value,
                           reference=ua.ObjectIds.HasProperty, kind=ua.ObjectIds.PropertyType)  # fmt: skip
        for made in self._state_machine("type/DriveType", self.node("type/DriveType")):
            if made == self.node("type/DriveType/machine"):
                self._rule(made, mandatory=True)
        self._declare("BusType", bus_of(Plant(plan=PlanPlant(cycle_us=1), slaves={})), bus_of(Plant(slaves={})))
        with_all = slave_of(0, SlavePlant(dpv1=True, drive=DrivePlant()), writable=False)
        own = tuple(node for node in with_all.nodes if node.kind is not Kind.DRIVE)
        self._declare("SlaveType", replace(with_all, nodes=own), slave_of(0, SlavePlant(), writable=True))
        for name in ("Inputs", "Outputs", "Drive"):
            kind = self.node("type/DriveType") if name == "Drive" else ua.NodeId(ua.ObjectIds.FolderType)
            part = self._object(f"type/SlaveType/{name}", self.node("type/SlaveType"), name, kind)
            self._rule(part, mandatory=False)
        of_drive = (node for node in with_all.nodes if node.kind is Kind.DRIVE)
        drive = Described("", tuple(replace(node, path=node.path[1:]) for node in of_drive))
        self._declare("DriveType", drive, drive)

    def _declare(self, name: str, most: Described, least: Described) -> None:
        """Members of a type: those of ``least`` are in each object, the others of ``most`` in some."""
        own = f"type/{name}"
        folders: dict[tuple[str, ...], ua.NodeId] = {(): self.node(own)}
        always = {node.path[:depth] for node in least.nodes for depth in range(1, len(node.path) + 1)}
        for about in most.about:
            self._rule(self._about(own, about, ""), mandatory=False)
        for node in most.nodes:
            for path in self._add_folders(own, node.path[:-1], folders):
                self._rule(folders[path], mandatory=path in always)
            declared = replace(node, id=f"{own}/value/{'/'.join(node.path)}")
            for made in self._value(declared, folders[node.path[:-1]], node.path[-1], writable=False):
                self._rule(made, mandatory=node.path in always)

    def _rule(self, member: ua.NodeId, *, mandatory: bool) -> None:
        """The modelling rule of a type's member (Part 3, 6.4.4)."""
        rule = ua.ObjectIds.ModellingRule_Mandatory if mandatory else ua.ObjectIds.ModellingRule_Optional
        self._refer(member, ua.ObjectIds.HasModellingRule, ua.NodeId(rule), ua.NodeClass.Object)

    def _state_machine(self, own: str, drive: ua.NodeId) -> Iterator[ua.NodeId]:
        machine = self._object(f"{own}/machine", drive, "StateMachine", self.node("type/DriveStateMachineType"))
        yield machine
        for part, name, kind in (
            ("state", "CurrentState", ua.ObjectIds.FiniteStateVariableType),
            ("transition", "LastTransition", ua.ObjectIds.FiniteTransitionVariableType),
        ):
            id_ = f"{own}/machine/{part}"
            variable = self._variable(id_, machine, ua.QualifiedName(name, 0), _V.LocalizedText, None, kind=kind)
            yield variable
            yield self._variable(f"{id_}/id", variable, ua.QualifiedName("Id", 0), _V.NodeId, None,
                                 reference=ua.ObjectIds.HasProperty, kind=ua.ObjectIds.PropertyType)  # fmt: skip

    def _transition(self, before: str, after: str) -> ua.NodeId:
        """The node of a transition of the type (Part 16, 4.4.11); it is made when it is needed first."""
        text = f"transition/{before}/{after}"
        id_ = self.node(text)
        if id_ not in self._server.aspace:
            machine = self.node("type/DriveStateMachineType")
            self._object(text, machine, f"{before} to {after}", ua.NodeId(ua.ObjectIds.TransitionType))
            number = ua.Variant(DRIVE_STATES.index(before) * 100 + DRIVE_STATES.index(after), _V.UInt32)
            self._variable(f"{text}/number", id_, ua.QualifiedName("TransitionNumber", 0), _V.UInt32, number,
                           reference=ua.ObjectIds.HasProperty, kind=ua.ObjectIds.PropertyType)  # fmt: skip
            for kind, state in ((ua.ObjectIds.FromState, before), (ua.ObjectIds.ToState, after)):
                self._refer(id_, kind, self.node(f"state/{state}"), ua.NodeClass.Object)
        return id_

    async def build(
        self, bus: tuple[str, tuple[Node, ...]], slaves: Mapping[int, Described], allowed: frozenset[str]
    ) -> tuple[list[str], bool]:
        """Make the nodes those of the tree: new and changed slaves are made anew, others stay. Returns one line for
        each changed name, and whether anything has changed."""
        wanted: dict[int | None, Described] = {None: Described(*bus)}
        wanted.update(slaves.items())
        found = unique_names(OPCUA_BROWSE, ((f"slave {at}", one.name) for at, one in slaves.items()))
        names: dict[int | None, str] = {None: "Bus"}
        names.update((at, found.names[f"slave {at}"]) for at in slaves)
        changed: list[str] = list(found.changed)
        gone = [
            key for key, one in self._built.items()
            if key not in wanted or (one.described, one.name) != (wanted[key], names[key])
            or one.allowed != _of(wanted[key], allowed)
        ]  # fmt: skip
        if None in gone:
            gone = list(self._built)  # slaves are components of the bus
        for key in sorted(gone, key=lambda one: one is None):
            await self._remove(key)
        new = [key for key in wanted if key not in self._built]
        for key in new:
            made = [node async for node in self._add(key, names[key], wanted[key], allowed, changed)]
            self._built[key] = _Built(wanted[key], names[key], _of(wanted[key], allowed), tuple(made))
        self.names = names
        return changed, bool(gone or new)

    async def write(self, node: Node, reading: Reading, wall: Callable[[float], datetime]) -> ua.DataValue | None:
        """Write the value of ``node``; returns it, None if there is no such node."""
        id_ = self.node(node.id)
        if self.values.get(id_) is None:
            return None
        made = data_value(node, reading, wall)
        await self._put(id_, made)
        if node.kind in _WITH_REASON:
            await self._show_reason(self.node(_property_id(node, "reason")), reading.text, made)
        if node.kind is Kind.DRIVE and node.keys == ("drive", "state"):
            await self._show_state(node, made)
        return made

    async def _put(self, id_: ua.NodeId, value: ua.DataValue) -> None:
        """Write a value. asyncua takes the number of a bad one away, as Part 4, 7.11.1, has it; here it stays."""
        attribute = self._server.aspace[id_].attributes[ua.AttributeIds.Value]
        attribute.value = value
        for handle in tuple(attribute.datachange_callbacks):
            if (callback := attribute.datachange_callbacks.get(handle)) is not None:
                await callback(handle, value)

    async def _show_reason(self, id_: ua.NodeId, text: str, value: ua.DataValue) -> None:
        if self._reasons.get(id_, "") == text:
            return
        self._reasons[id_] = text
        now = value.ServerTimestamp
        shown = SharedValue(ua.Variant(text, _V.String), StatusCode=ua.StatusCode(), SourceTimestamp=now,
                            ServerTimestamp=now)  # fmt: skip
        await self._put(id_, shown)

    async def _show_state(self, node: Node, made: ua.DataValue) -> None:
        own = f"slave/{node.slave}/drive"
        state = made.Value.Value if made.Value is not None else None
        name = state if isinstance(state, str) else ""
        known = name in DRIVE_STATES
        shows = [("state", name, self.node(f"state/{name}") if known else ua.NodeId())]
        before = self._states.get(own)
        if known and made.StatusCode is not None and made.StatusCode.is_good():
            self._states[own] = name
            if before is not None and before != name:
                shows.append(("transition", f"{before} to {name}", self._transition(before, name)))
        for id_, value in (
            pair
            for part, text, target in shows
            for pair in (
                (f"{own}/machine/{part}", ua.Variant(ua.LocalizedText(text), _V.LocalizedText)),
                (f"{own}/machine/{part}/id", ua.Variant(target, _V.NodeId)),
            )
        ):
            shown = SharedValue(value, StatusCode=made.StatusCode, SourceTimestamp=made.SourceTimestamp,
                                 ServerTimestamp=made.ServerTimestamp)  # fmt: skip
            await self._put(self.node(id_), shown)

    # --- nodes of the tree ----------------------------------------------------------------------------------------

    async def _add(
        self, key: int | None, name: str, described: Described, allowed: frozenset[str], changed: list[str]
    ) -> Any:
        own = "bus" if key is None else f"slave/{key}"
        parent = ua.NodeId(ua.ObjectIds.ObjectsFolder) if key is None else self.node("bus")
        type_ = self.node("type/BusType" if key is None else "type/SlaveType")
        reference = ua.ObjectIds.Organizes if key is None else ua.ObjectIds.HasComponent
        root = self._object(own, parent, name, type_, reference=reference, events=True)
        yield root
        notifier = ua.NodeId(ua.ObjectIds.Server) if key is None else self.node("bus")
        self._refer(notifier, ua.ObjectIds.HasNotifier, root, ua.NodeClass.Object)
        for about, text in described.about.items():
            if text:
                yield self._about(own, about, text)
        folders: dict[tuple[str, ...], ua.NodeId] = {(): root}
        drives = [node for node in described.nodes if node.kind is Kind.DRIVE]
        if drives:
            drive = folders["Drive",] = self._object(f"{own}/drive", root, "Drive", self.node("type/DriveType"))
            yield drive
            for node in self._drive_parts(own, drive, described, allowed):
                yield node
        names = self._value_names(described, changed)
        for node in described.nodes:
            for path in self._add_folders(own, node.path[:-1], folders):
                yield folders[path]
            self.values[self.node(node.id)] = node
            writable = node.order is not None and node.order.name in allowed
            for made in self._value(node, folders[node.path[:-1]], names[node.id], writable=writable):
                yield made
            if self._made >= _AT_ONCE:
                await asyncio.sleep(0)
                self._made = 0

    def _about(self, own: str, about: str, text: str) -> ua.NodeId:
        return self._variable(f"{own}/about/{about}", self.node(own), about, _V.String, ua.Variant(text, _V.String),
                              reference=ua.ObjectIds.HasProperty, kind=ua.ObjectIds.PropertyType)  # fmt: skip

    def _add_folders(
        self, own: str, path: tuple[str, ...], folders: dict[tuple[str, ...], ua.NodeId]
    ) -> Iterator[tuple[str, ...]]:
        """Add the folders of ``path`` that are not among ``folders`` yet; yields their paths."""
        for depth in range(1, len(path) + 1):
            part = path[:depth]
            if part not in folders:
                id_, kind = f"{own}/folder/{'/'.join(part)}", ua.NodeId(ua.ObjectIds.FolderType)
                folders[part] = self._object(id_, folders[part[:-1]], OPCUA_BROWSE.valid(part[-1]), kind)
                yield part

    def _value_names(self, described: Described, changed: list[str]) -> dict[str, str]:
        groups: dict[tuple[str, ...], list[tuple[str, str]]] = {}
        for node in described.nodes:
            groups.setdefault(node.path[:-1], []).append((node.id, node.path[-1]))
        names: dict[str, str] = {}
        for group in groups.values():
            found = unique_names(OPCUA_BROWSE, group)
            names.update(found.names)
            changed += found.changed
        return names

    def _value(self, node: Node, parent: ua.NodeId, name: str, *, writable: bool) -> Iterator[ua.NodeId]:
        analog = node.kind is Kind.VALUE and bool(node.unit or node.scale != 1 or node.offset != 0)
        kind = ua.ObjectIds.BaseAnalogType if analog else ua.ObjectIds.BaseDataVariableType
        id_ = self._variable(node.id, parent, name, VARIANTS[node.type], None, kind=kind,
                             access=_READ | (_WRITE if writable else 0), text=node.text)  # fmt: skip
        yield id_
        if analog and node.unit:
            unit = ua.EUInformation(NAMESPACE, -1, ua.LocalizedText(node.unit), ua.LocalizedText(node.unit))
            yield self._property(_property_id(node, "unit"), id_, "EngineeringUnits", unit, ua.ObjectIds.EUInformation)
        if analog and node.low is not None and node.high is not None:
            both = ua.Range(float(node.low), float(node.high))
            yield self._property(_property_id(node, "range"), id_, "EURange", both, ua.ObjectIds.Range)
        if node.kind in _WITH_REASON:
            reason = _property_id(node, "reason")
            yield self._variable(reason, id_, "Reason", _V.String, ua.Variant("", _V.String),
                                 reference=ua.ObjectIds.HasProperty, kind=ua.ObjectIds.PropertyType,
                                 text="the words for the status code of the value")  # fmt: skip

    def _drive_parts(
        self, own: str, drive: ua.NodeId, described: Described, allowed: frozenset[str]
    ) -> Iterator[ua.NodeId]:
        yield from self._state_machine(f"{own}/drive", drive)
        for order in described.orders:
            word = order.operation
            if word is None or word not in METHODS:
                continue
            method = self.node(f"{own}/drive/method/{word}")
            self._method(method, drive, METHODS[word], executable=order.name in allowed)
            self.methods[method] = (drive, order)
            yield method
            if order.type is not None:
                given = ua.Argument(Name="value", DataType=ua.NodeId(VARIANTS[order.type].value), ValueRank=-1,
                                    Description=ua.LocalizedText("part of the reference: 1.0 is 100 %"))  # fmt: skip
                yield self._property(f"{own}/drive/method/{word}/in", method, "InputArguments", [given],
                                     ua.ObjectIds.Argument)  # fmt: skip

    async def _remove(self, key: int | None) -> None:
        built = self._built.pop(key)
        self._states.pop(f"slave/{key}/drive", None)
        space = self._server.aspace
        gone = set(built.nodes)
        for number, id_ in enumerate(built.nodes, 1):
            if number % _AT_ONCE == 0:
                await asyncio.sleep(0)
            data = space[id_]
            for attribute in data.attributes.values():
                for handle, callback in tuple(attribute.datachange_callbacks.items()):
                    bad = ua.DataValue(ua.Variant(), StatusCode=ua.StatusCode(ua.StatusCodes.BadNodeIdUnknown),
                                       ServerTimestamp=datetime.now(UTC))  # fmt: skip
                    await callback(handle, bad)
                    space.delete_datachange_callback(handle)
            self.values.pop(id_, None)
            self._reasons.pop(id_, None)
            self.methods.pop(id_, None)
        for outside in (ua.NodeId(ua.ObjectIds.ObjectsFolder), ua.NodeId(ua.ObjectIds.Server), self.node("bus")):
            data = space.get(outside)
            if data is not None and outside not in gone:
                data.references = [one for one in data.references if one.NodeId not in gone]
        for id_ in built.nodes:
            del space[id_]
        await asyncio.sleep(0)

    # --- single nodes ---------------------------------------------------------------------------------------------

    def _type(self, name: str, parent: ua.NodeId) -> None:
        attributes = ua.ObjectTypeAttributes()
        attributes.DisplayName = ua.LocalizedText(name)
        self._make(self.node(f"type/{name}"), parent, ua.ObjectIds.HasSubtype, name, ua.NodeClass.ObjectType,
                   attributes)  # fmt: skip

    def _object(
        self, id_: str, parent: ua.NodeId, name: str, type_: ua.NodeId, *,
        reference: int = ua.ObjectIds.HasComponent, events: bool = False,
    ) -> ua.NodeId:  # fmt: skip
        attributes = ua.ObjectAttributes()
        attributes.DisplayName = ua.LocalizedText(name)
        attributes.EventNotifier = 1 if events else 0
        return self._make(self.node(id_), parent, reference, name, ua.NodeClass.Object, attributes, type_)

    def add_last_command(self) -> None:
        """Name, Result, Reason of the last order that a client gave."""
        server = ua.NodeId(ua.ObjectIds.ObjectsFolder)
        last = self._object("last", server, "LastCommand", self.node("type/LastCommandType"),
                            reference=ua.ObjectIds.Organizes)  # fmt: skip
        for name in ("Name", "Result", "Reason"):
            self._variable(f"last/{name}", last, name, _V.String, ua.Variant("", _V.String))

    def _property(self, id_: str, parent: ua.NodeId, name: str, value: object, type_: int) -> ua.NodeId:
        return self._variable(id_, parent, ua.QualifiedName(name, 0), _V.ExtensionObject, ua.Variant(value),
                              reference=ua.ObjectIds.HasProperty, kind=ua.ObjectIds.PropertyType,
                              data_type=ua.NodeId(type_))  # fmt: skip

    def _variable(
        self, id_: str, parent: ua.NodeId, name: str | ua.QualifiedName, type_: ua.VariantType,
        value: ua.Variant | None, *, reference: int = ua.ObjectIds.HasComponent,
        kind: int = ua.ObjectIds.BaseDataVariableType, access: int = 1 << ua.AccessLevel.CurrentRead, text: str = "",
        data_type: ua.NodeId | None = None,
    ) -> ua.NodeId:  # fmt: skip
        attributes = ua.VariableAttributes()
        attributes.DisplayName = ua.LocalizedText(name if isinstance(name, str) else name.Name)
        attributes.Description = ua.LocalizedText(text)
        attributes.DataType = data_type or ua.NodeId(type_.value)
        attributes.Value = ua.Variant() if value is None else value
        attributes.ValueRank = 1 if value is not None and value.is_array else -1
        attributes.AccessLevel = attributes.UserAccessLevel = access
        attributes.Historizing = bool(access & 1 << ua.AccessLevel.HistoryRead)
        made = self._make(self.node(id_), parent, reference, name, ua.NodeClass.Variable, attributes, ua.NodeId(kind))
        if value is None:
            self._server.aspace[made].attributes[ua.AttributeIds.Value].value = _NONE
        return made

    def _method(self, id_: ua.NodeId, parent: ua.NodeId, name: str, *, executable: bool) -> None:
        attributes = ua.MethodAttributes()
        attributes.DisplayName = ua.LocalizedText(name)
        attributes.Executable = attributes.UserExecutable = executable
        self._make(id_, parent, ua.ObjectIds.HasComponent, name, ua.NodeClass.Method, attributes)

    def _make(
        self, id_: ua.NodeId, parent: ua.NodeId, reference: int, name: str | ua.QualifiedName, class_: ua.NodeClass,
        attributes: Any, type_: ua.NodeId | None = None,
    ) -> ua.NodeId:  # fmt: skip
        space = self._server.aspace
        above = space[parent]
        item = ua.AddNodesItem()
        item.RequestedNewNodeId = id_
        item.BrowseName = ua.QualifiedName(name, self._index) if isinstance(name, str) else name
        item.NodeClass = class_
        item.TypeDefinition = type_ or ua.NodeId()
        item.NodeAttributes = attributes
        self._made += 1
        # without its parent: asyncua compares each new node with all that the parent has already
        if [*self._server.node_mgt_service.try_add_nodes([item], check=False)]:
            raise ValueError(f"{id_} is there already, or has an unknown type")
        kind = ua.NodeId(reference)
        down = _reference(kind, id_, class_, item.BrowseName, attributes.DisplayName, item.TypeDefinition)
        above.references.append(down)
        class_above, browse, display = (
            space.read_attribute_value(parent, one).Value.Value
            for one in (ua.AttributeIds.NodeClass, ua.AttributeIds.BrowseName, ua.AttributeIds.DisplayName)
        )
        types = (one.NodeId for one in above.references if one.IsForward and one.ReferenceTypeId == _TYPE_DEFINITION)
        type_above = next(types, None) if class_above in _INSTANCES else None
        up = _reference(kind, parent, class_above, browse, display, type_above, is_forward=False)
        space[id_].references.insert(0, up)
        return id_

    def _refer(self, source: ua.NodeId, kind: int, target: ua.NodeId, class_: ua.NodeClass) -> None:
        item = ua.AddReferencesItem()
        item.SourceNodeId, item.ReferenceTypeId, item.TargetNodeId = source, ua.NodeId(kind), target
        item.IsForward, item.TargetNodeClass = True, class_
        [result] = self._server.node_mgt_service.add_references([item])
        result.check()


def _reference(
    kind: ua.NodeId, target: ua.NodeId, class_: ua.NodeClass, browse: ua.QualifiedName, display: ua.LocalizedText,
    type_: ua.NodeId | None, *, is_forward: bool = True,
) -> ua.ReferenceDescription:  # fmt: skip
    made = ua.ReferenceDescription()
    made.ReferenceTypeId, made.NodeId, made.NodeClass, made.IsForward = kind, target, class_, is_forward
    made.BrowseName, made.DisplayName = browse, display
    if type_ is not None:
        made.TypeDefinition = type_
    return made


def _property_id(node: Node, name: str) -> str:
    """No value has this id, whatever its name is."""
    return f"property/{node.id}/{name}"


def data_value(node: Node, reading: Reading, wall: Callable[[float], datetime]) -> ua.DataValue:
    """``reading`` as OPC UA has it: a bad one keeps its number beside its status, if there is one."""
    value = ua.Variant() if reading.value is None else ua.Variant(reading.value, VARIANTS[node.type])
    return SharedValue(
        value,
        StatusCode=ua.StatusCode(reading.opcua_status),
        SourceTimestamp=wall(reading.time) if reading.time else None,
        ServerTimestamp=datetime.now(UTC),
    )


def _of(described: Described, allowed: frozenset[str]) -> frozenset[str]:
    return frozenset(order.name for order in described.orders if order.name in allowed)
