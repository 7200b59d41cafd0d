"""Benchmarks of gateways, which publish a plant: ``python -m bench connectors`` and ``python -m bench fleet``.

- ``backlog``: A backlog in the store of MQTT, and its arrival at a subscriber
- ``bus``: A gateway as users run it: a bus with a process of its own on a port, published by MQTT
- ``connector_ends``: Clients and brokers around the connectors of the benchmark ``connectors``
- ``connectors``: The benchmark ``connectors``: the cost of all connectors of a gateway to its bus
- ``fleet``: The benchmark ``fleet``: starts everything, measures, kills the broker, has all messages judged
- ``gateways``: Many gateways in one process, each fed by a recorded live stream
- ``judge``: The messages of a subscriber: counts, times, and the order that Sparkplug B asks for
- ``programs``: The programs of a run: broker, subscriber, buses, gateways; their CPU time and memory
- ``slaves``: Simulated slaves on a pty, which lose their power and get it back at known times
- ``stream``: The recording of a live stream, and its replay at real speed
- ``subscriber``: A subscriber that notes everything with its time of arrival
"""
