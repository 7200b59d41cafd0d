"""The stream of a running bus: its plant, snapshots and events as plain data, for screen, page, recording, bridges.

- ``items``: Types of the items of the live stream, and the check of items from other programs (docs/reference/live.md)
- ``pending``: The items that wait for one reader: events up to a limit, snapshots merged into one
- ``state``: The plant as the items so far describe it, for a face that shows it
"""
