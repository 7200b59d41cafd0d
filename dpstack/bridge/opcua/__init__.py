"""OPC UA: the tree as typed nodes with quality, orders as writes and methods, alarms, history of the last hour.

Needs the extra ``opcua`` (asyncua). docs/reference/opcua.md has the nodes, status codes and limits.

- ``alarms``: Conditions as events of OffNormalAlarmType; ConditionRefresh
- ``certificate``: The server's certificate and key, made at the first start; the judgement of a client's
- ``connection``: Connections of clients, with bounds for octets, handshakes and unread answers; the server as a whole
- ``connector``: The connector: changes of the tree in; values, events and history out; orders of clients
- ``decoding``: A bound for what asyncua decodes of a client's octets
- ``history``: Values of the last hour, with one bound over all
- ``lateness``: The age of requests that a connection delivers late
- ``sessions``: Sessions with rights and limits
- ``space``: Types and nodes
- ``standard_nodes``: The standard nodes that a plant needs, from a file of the package
- ``subscriptions``: Subscriptions with bounds for messages, queues and filters
- ``users``: A private file with users and scrypt hashes
"""
