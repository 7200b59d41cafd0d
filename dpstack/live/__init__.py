"""The stream of a running bus: its plant, snapshots and events as plain data, for screen, page, recording, bridges.

- ``items``: Types of the items of the live stream, and the check of items from other programs (docs/reference/live.md)
- ``judge``: Verdicts on a slave for people, made once: alive, level, words of its state, its most important remark
- ``pending``: The items that wait for one reader: events up to a limit, snapshots merged into one
- ``state``: The plant as the items so far describe it, for a face that shows it
"""
