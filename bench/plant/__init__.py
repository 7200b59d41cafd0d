"""A plant of many gateways against a real broker: ``python -m bench fleet``.

- ``bus``: A gateway as users run it: a bus with a process of its own on a port, published by MQTT
- ``fleet``: The benchmark itself: starts everything, measures, kills the broker, judges
- ``gateways``: Many gateways in one process, each fed by a recorded live stream
- ``judge``: The messages of a subscriber: counts, times, and the order that Sparkplug B asks for
- ``programs``: The programs of a run: broker, subscriber, buses, gateways; their CPU time and memory
- ``slaves``: Simulated slaves on a pty, which lose their power and get it back at known times
- ``stream``: The recording of a live stream, and its replay at real speed
- ``subscriber``: A subscriber that notes everything with its time of arrival
"""
