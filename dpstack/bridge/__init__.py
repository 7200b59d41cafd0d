"""Connectors: MQTT, OPC UA, EPICS, metrics publish the tree of a plant (:mod:`dpstack.plant.tree`), take its orders.

Protocol libraries are loaded by the connector that needs them only. docs/explanation/bridge.md has the rules.

- ``epics/``: EPICS process variables over Channel Access
- ``homeassistant/``: Discovery messages by which Home Assistant makes devices and entities of a plant over MQTT
- ``metrics/``: Prometheus metrics and health over HTTP
- ``mqtt/``: MQTT 5 with Sparkplug B 3.0 (the bus as an edge node, its slaves as devices) or plain JSON
- ``opcua/``: OPC UA: typed nodes, orders, alarms, history
- ``connector``: The base class of a connector, which publishes the tree
- ``gateway``: The live stream in, the changes of the tree out to the connectors; the end of connectors
- ``names``: Names of slaves and values as Sparkplug B, OPC UA, Prometheus and EPICS permit them
- ``orders``: The orders that a connector may give: allow list, age, one at a time a slave
- ``processor_share``: A bound for the processor time that the requests of clients take
"""
