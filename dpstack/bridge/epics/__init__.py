"""EPICS: the tree as process variables over Channel Access, with alarms, times and orders.

Needs the extra ``epics`` (caproto). docs/reference/epics.md has the names, alarms and limits, and says why caproto.

- ``alarms``: Alarm status and severity by quality, and by states that somebody should look at
- ``circuit``: The connection of one client: channels, monitors, puts
- ``connector``: The connector: changes of the tree in, values out; orders of clients
- ``names``: The process variables of a tree by name
- ``server``: Sockets: searches, beacons, connections
- ``variables``: A process variable as Channel Access has it: type, value, unit, limits; the value of a put
"""
