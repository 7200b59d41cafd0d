"""The stream of a running bus: its plant, snapshots and events as plain data, for screen, page, recording, bridges.

- ``items``: The shape of the items of the stream: what every reader may rely on (docs/reference/live.md)
- ``pending``: The items that wait for one reader: events up to a limit, snapshots merged into one
- ``state``: The plant as the items so far describe it, for a face that shows it
"""
