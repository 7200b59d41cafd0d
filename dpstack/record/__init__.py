"""Recordings of process data: columns, rows as CSV and JSON lines, reading, replay, plots. Nothing here knows a bus.

- ``columns``: The columns of a recording: named values, states, drive quantities; and their names in files
- ``plot``: A recording as a picture: values over wall clock, a pane for each unit, bits and states as bands
- ``reader``: Recordings read from CSV, JSON lines or Parquet, also rotated sets of files
- ``replay``: A recording as the items of a live stream: plant, snapshots, events, end; at real speed, or any other
- ``rows``: Samples of the process data as lines of CSV or JSON, every cycle or on change
"""
