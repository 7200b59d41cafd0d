"""One tree of a plant, made from the items of its live stream, for MQTT, OPC UA and metrics.

The tree reads no clock, no file and no network: the caller gives items and the time. Only ``gateway`` waits. Protocol
libraries are not needed. docs/explanation/bridge.md has the rules.

- ``metrics/``: Prometheus metrics and health over HTTP
- ``mqtt/``: MQTT 5 with Sparkplug B 3.0 (the bus as an edge node, its slaves as devices) or plain JSON
- ``opcua/``: OPC UA: typed nodes, orders, alarms, history
- ``conditions``: Diagnoses, faults and alarms as conditions that are active, acknowledged, retained
- ``face``: The base class of a face, which publishes the tree
- ``gateway``: The live stream in, the changes of the tree out to the faces; the end of faces
- ``names``: Names of slaves and values as Sparkplug B, OPC UA and Prometheus permit them
- ``nodes``: The nodes of a bus and of a slave with type, unit, scale and dead band; the orders that they take
- ``orders``: The orders that a face may give: allow list, age, one at a time a slave
- ``quality``: Values with quality, reason and source time; values of the stream by type
- ``tree``: The tree: items in; changed values, births, deaths and conditions out
- ``verdicts``: Verdicts on a running bus and its slaves, by the counters of the run
"""
