"""A plant as typed values, without bus and network: its state, the verdicts on it, its orders; and its live stream.

Nothing here reads a clock, a file or a network: the caller gives items and the time. docs/reference/live.md describes
the stream, docs/explanation/bridge.md the tree.

- ``conditions``: Diagnoses, faults and alarms as conditions that are active, acknowledged, retained
- ``items``: Types of the items of the live stream, and the check of items from other programs
- ``judge``: Verdicts on a slave for people, made once: alive, level, words of its state, its most important remark
- ``nodes``: The nodes of a bus and of a slave with type, unit, scale and dead band; the orders that they take
- ``orders``: Orders to a plant: named outputs of a slave, the operation of a drive, the mode of the master
- ``pending``: The items that wait for one reader: events up to a limit, snapshots merged into one
- ``quality``: Values with quality, reason and source time; values of the stream by type
- ``sender``: The live stream to a reader in another program, as fast as that one reads
- ``state``: The plant as the items so far describe it
- ``status_octet``: The status octet beside a value: quality and words of PROFIBUS PA, in the classic and the condensed
  coding
- ``tree``: The tree: items in; changed values, births, deaths and conditions out
- ``value_quality``: The quality of the values of a slave: the reason why none of them is good, and the worse ones of
  single values
- ``verdicts``: Verdicts on a running bus and its slaves, by the counters of the run
"""
