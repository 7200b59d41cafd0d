"""One tree of a plant, made from the items of its live stream, for MQTT, OPC UA and metrics.

Nothing here reads a clock, a file or a network: the caller gives items and the time. Protocol libraries are not needed.
docs/explanation/bridge.md has the rules.

- ``conditions``: Diagnoses, faults and alarms as conditions that are active, acknowledged, retained
- ``names``: Names of slaves and values as Sparkplug B, OPC UA and Prometheus permit them
- ``nodes``: The nodes of a bus and of a slave with type, unit, scale and dead band; the orders that they take
- ``quality``: Values with quality, reason and source time; values of the stream by type
- ``tree``: The tree: items in; changed values, births, deaths and conditions out
"""
