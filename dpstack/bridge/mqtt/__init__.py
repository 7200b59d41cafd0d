"""A plant over MQTT 5 (extra ``mqtt``): an edge node of Sparkplug B 3.0, or topics with plain JSON.

- ``broker``: Address, TLS, user and password of the broker; the folder for the state of an edge node
- ``client``: The connector of MQTT over one connection to a broker, with aiomqtt
- ``connection``: A connection to a broker with aiomqtt: limits, errors, end
- ``edge_node``: The edge node: births, data, deaths and commands in their order. Knows no network and no clock
- ``fleet``: All segments of a broker from their statuses, births and deaths
- ``fleet_reader``: The statuses of a broker read over one connection that is made again; publishes nothing by itself
- ``history``: Store and forward in memory: values that could not be delivered, and those that are confirmed
- ``history_file``: Values that could not be delivered on disk (SQLite), bounded, the oldest dropped first
- ``history_keeper``: Moves them between memory and disk, in a thread of its own
- ``json_node``: Topics with plain JSON: values, conditions, orders, results. Knows no network and no clock
- ``json_payload``: Payloads of plain JSON: values, conditions, results; orders that come
- ``limited_client``: A client that reads no more than its share of what the broker sends
- ``payload``: Payloads of Sparkplug B: nodes of the tree as metrics, and the metrics of commands
- ``plant_node``: The base class of ``edge_node`` and ``json_node``, and its messages for the client
- ``session_file``: The number of the MQTT session on disk (bdSeq), and the lock against a second gateway
- ``sparkplug_pb2``: The messages of Sparkplug B, made from sparkplug.proto by tools/make_sparkplug_proto.py
- ``status``: The status of a segment for ``dpstack fleet``: its content, when it is due, and its reader
- ``worker_thread``: Calls that may block without a limit in threads that never delay the end of the program
"""
