"""The commands that only listen to a bus, or explain what was heard on it; none of them sends an octet.

- ``baud``: ``dpstack baud``: finds the baud rate by listening only
- ``capture``: ``dpstack capture``: listens and keeps what it hears in a pcapng file, or explains it on the screen
- ``capture_set``: Capture files that commands name, and those in folders; several that are judged as one
- ``decode``: ``dpstack decode``: explains every telegram of a capture, or of octets in hex, to the bit
- ``diagnosis``: ``dpstack decode --diagnosis``: a diagnosis without its telegram, in words
- ``file_jobs``: Captures read by several processes: each reads pieces of a file, one process counts all of them in
  their order
- ``judged_file``: Capture files judged by a monitor: the first port, gaps and remarks
- ``monitor``: ``dpstack monitor``: judges a bus by listening, live or from a capture file
- ``monitor_live``: The monitor at a port: listens, shows the bus as it is, and judges it at the end
- ``monitor_view``: The monitored bus on a screen: a live list that is redrawn, lines of events, tables at the end
- ``parquet_files``: ``dpstack decode --parquet``: the telegrams of captures as Parquet files
- ``port_listener``: ``PortListener``: common part of the commands that listen to a port
- ``progress``: The progress of reading files: one line on standard error that is written over, on a terminal only
- ``source_file``: Files that are decoded or judged: opening them, and the transmissions in them
- ``telegram_lines``: Explained telegrams on the screen or as JSON lines, and the argument of ``--filter``
- ``wireshark``: ``dpstack wireshark``: dissector and extcap program for the Wireshark that is there
"""
