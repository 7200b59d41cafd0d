"""Files of a running bus: recordings of process data, logs of events. A thread writes them, and the bus never waits.

- ``event_log``: The log of events: one line each, with wall clock; a few files, the oldest one removed
- ``line_file``: A file of whole lines, also on a disk that becomes full
- ``parquet``: A recording in CSV made into a Parquet file, by a process of its own
- ``record_file``: The files of a recording, with rotation by size or time
- ``rotation``: The argument of ``--rotate``: a size or a time
- ``writer_thread``: A thread that encodes and writes what the event loop puts into its queue
"""
