"""Configurations of entities of Home Assistant: nodes of the tree, whether a slave is there, orders to drives.

A value is available while its quality is good or uncertain, and the gateway is connected. Only orders that
``allow_commands`` lists make a switch, a number or a button. docs/how-to/home-assistant.md has the reasons.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any, Final, NamedTuple

from dpstack.bridge.homeassistant import words
from dpstack.bridge.homeassistant.words import Unit, unit_of
from dpstack.plant.nodes import Kind, Node, digits_of
from dpstack.plant.orders import HALTS, Operation
from dpstack.plant.quality import BOOL, BYTES, TEXT
from dpstack.text import shortened

#: keys of a configuration with their values
Config = dict[str, Any]
#: greatest number of four octets (IEEE 754): the range of a number that has none
_MOST: Final = 3.4028234e38
_MOST_PERCENT: Final = 1000
#: the smallest step of a number that Home Assistant takes
_SMALLEST_STEP: Final = 0.001
#: characters of a name: Home Assistant makes an id of 255 characters at most of those of device and entity
_MOST_NAME: Final = 80
#: all others are diagnostic: without statistics, and not in the middle of the page
_PROCESS: Final = frozenset({Kind.VALUE, Kind.DRIVE})
_DIAGNOSTIC: Final = "diagnostic"
#: of a button: what it does, for the icon
_ICONS: Final[Mapping[Operation, str]] = {
    "start": "mdi:play",
    "stop": "mdi:stop",
    "quick_stop": "mdi:stop-circle",
    "coast": "mdi:power",
    "acknowledge": "mdi:check",
}


class Gateway(NamedTuple):
    """Common to all entities of a gateway. ``base``: in front of all its topics, and its id; ``name``: of its device;
    ``expiry_s``: s in which each of its topics is sent again; ``takes_orders``: some order is allowed; ``version``: of
    dpstack."""

    base: str
    name: str
    expiry_s: int
    takes_orders: bool
    version: str


class Shown(NamedTuple):
    """A node of the tree in a topic of plain JSON, which has its value as ``member``. ``order_topic``: for the order
    that sets it; empty: it can only be read."""

    node: Node
    topic: str
    member: str
    order_topic: str = ""


class Device(NamedTuple):
    """The bus (``address`` None) or a slave. ``online_topic``: says whether it is there; ``buttons``: orders without an
    argument that are allowed, with the topic of each."""

    address: int | None
    name: str
    about: Mapping[str, str]
    online_topic: str
    shown: Sequence[Shown]
    buttons: Sequence[tuple[Operation, str]] = ()


class Entity(NamedTuple):
    """``id``: of one entity of the gateway, for ever; ``config``: makes its configuration."""

    component: str
    id: str
    config: Callable[[], Config]


def entities(gateway: Gateway, device: Device) -> Iterator[Entity]:
    """The entities of a device. Statistics have none: they change all the time, and nobody at home needs them."""
    own = "bus" if device.address is None else f"slave/{device.address}"

    def entity(component: str, id_: str, make: Callable[[], Config]) -> Entity:
        return Entity(component, id_, partial(_with_device, gateway, device, id_, make))

    yield entity("binary_sensor", f"{own}/online", partial(_online, gateway, device))
    shown = [one for one in device.shown if one.node.kind is not Kind.STATISTIC]
    names = Counter(_name(one.node).casefold() for one in shown)
    for one in shown:
        name = _name(one.node)
        if names[name.casefold()] > 1 and len(one.node.path) > 1:
            name = f"{name} ({one.node.path[0].lower()})"
        component = _component(one)
        yield entity(component, one.node.id, partial(_value, gateway, one, component, name))
    for operation, topic in device.buttons:
        yield entity("button", f"{own}/order/{operation}", partial(_button, gateway, device, operation, topic))
    if device.address is None and gateway.takes_orders:
        yield entity("sensor", f"{own}/result", partial(_last_order, gateway))


def _name(node: Node) -> str:
    path = node.path[1:] or node.path
    if node.kind is Kind.VALUE:
        return path[-1]
    return " ".join(path).removesuffix("_hz").replace("_", " ").capitalize()


def _component(shown: Shown) -> str:
    if shown.node.type == BOOL:
        return "switch" if shown.order_topic else "binary_sensor"
    # one for octets does not exist
    return "number" if shown.order_topic and shown.node.type not in (TEXT, BYTES) else "sensor"


def _with_device(gateway: Gateway, device: Device, id_: str, make: Callable[[], Config]) -> Config:
    is_bus = device.address is None
    about: Config = {
        "identifiers": [gateway.base if is_bus else f"{gateway.base}/slave/{device.address}"],
        "name": shortened(gateway.name if is_bus else device.name, _MOST_NAME),
        "manufacturer": device.about.get("vendor"),
        "model": "PROFIBUS master" if is_bus else device.about.get("model") or device.about.get("profile"),
        "model_id": device.about.get("ident"),
        "via_device": None if is_bus else gateway.base,
    }
    config = make()
    return config | {
        "name": shortened(config["name"], _MOST_NAME),
        "unique_id": f"{gateway.base}/{id_}",
        "device": {key: value for key, value in about.items() if value},
        "origin": {"name": "dpstack", "sw_version": gateway.version},
    }


def _online(gateway: Gateway, device: Device) -> Config:
    """The gateway says by its will that it is gone. A slave is not available then: nobody knows."""
    config = {
        "name": "Online",
        "state_topic": device.online_topic,
        "payload_on": words.TRUE,
        "payload_off": words.FALSE,
        "device_class": "connectivity",
        "entity_category": _DIAGNOSTIC,
    }
    return config if device.address is None else config | _availability(gateway)


def _availability(gateway: Gateway, *more: Config) -> Config:
    """Available while each of these topics, and that of the gateway, says ``true``. No topic may stand twice: Home
    Assistant looks at the last one only."""
    said = {"payload_available": words.TRUE, "payload_not_available": words.FALSE}
    topics = ({"topic": f"{gateway.base}/online"}, *more)
    return {"availability": [one | said for one in topics], "availability_mode": "all"}


def _value(gateway: Gateway, shown: Shown, component: str, name: str) -> Config:
    node = shown.node
    config: Config = {
        "name": name,
        "state_topic": shown.topic,
        "json_attributes_topic": shown.topic,
        "json_attributes_template": words.attributes(shown.member),
        **_availability(gateway, {"topic": shown.topic, "value_template": words.quality(shown.member)}),
    }
    if node.kind not in _PROCESS:
        config["entity_category"] = _DIAGNOSTIC
    if component in ("sensor", "binary_sensor"):
        config["expire_after"] = gateway.expiry_s
    if node.type == BOOL:
        config |= _flag(shown)
    elif node.type in (TEXT, BYTES):
        config["value_template"] = words.text(shown.member)
    else:
        config |= _number(shown, component)
    return config


def _flag(shown: Shown) -> Config:
    config: Config = {
        "value_template": words.flag(shown.member),
        "payload_on": words.TRUE,
        "payload_off": words.FALSE,
    }
    if shown.order_topic:
        return config | _order(shown.order_topic, words.COMMAND)
    return config | ({"device_class": "running"} if shown.node.keys == ("drive", "running") else {})


def _number(shown: Shown, component: str) -> Config:
    node = shown.node
    # parts of the reference or of a rated value
    percent = node.kind is Kind.DRIVE and not node.unit
    unit = Unit("%") if percent else unit_of(node.unit)
    template = words.percent if percent else words.single if node.type == "f32" else words.number
    config: Config = {"value_template": template(shown.member)}
    if unit.unit:
        config["unit_of_measurement"] = unit.unit
    if unit.device_class:
        config["device_class"] = unit.device_class
    if component == "sensor":
        if not percent and (digits := digits_of(node, 0)):
            config["suggested_display_precision"] = digits
        return config | ({"state_class": unit.state_class} if node.kind in _PROCESS else {})
    return (
        config
        | _range(node, percent=percent)
        | _order(shown.order_topic, words.COMMAND_PERCENT if percent else words.COMMAND)
    )


def _range(node: Node, *, percent: bool) -> Config:
    """Limits and step of a number. A whole number of the device has limits. Home Assistant does not show a value
    outside of them, but the one of before: so a set point has more room than drives have, which refuse what they cannot
    do."""
    if percent:
        return {"min": -_MOST_PERCENT, "max": _MOST_PERCENT, "step": 0.1, "mode": "box"}
    if node.low is None or node.high is None:
        return {"min": -_MOST, "max": _MOST, "step": _SMALLEST_STEP, "mode": "box"}
    return {"min": node.low, "max": node.high, "step": max(abs(node.scale), _SMALLEST_STEP), "mode": "box"}


def _order(topic: str, template: str) -> Config:
    """The state comes from the bus: nothing is assumed. A broker that kept an order would give it to a later run."""
    return {"command_topic": topic, "command_template": template, "retain": False, "optimistic": False}


def _button(gateway: Gateway, device: Device, operation: Operation, topic: str) -> Config:
    """A drive can be stopped whenever the gateway is there: the run keeps a halt for a drive that is away."""
    is_there = () if operation in HALTS else ({"topic": device.online_topic},)
    return {
        "name": operation.replace("_", " ").capitalize(),
        "icon": _ICONS[operation],
        "command_topic": topic,
        "command_template": words.PRESS,
        "retain": False,
        **_availability(gateway, *is_there),
    }


def _last_order(gateway: Gateway) -> Config:
    topic = f"{gateway.base}/result"
    return {
        "name": "Last order",
        "state_topic": topic,
        "value_template": words.RESULT,
        "json_attributes_topic": topic,
        "json_attributes_template": words.RESULT_ATTRIBUTES,
        "entity_category": _DIAGNOSTIC,
        **_availability(gateway),
    }
