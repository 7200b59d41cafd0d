"""Listening to a bus without sending: on a port of its own, or through the program that holds the port.

- ``capture_file``: The pcapng file of a capture: a new file, a ring of files, or standard output, written in whole
  blocks
- ``heard_bus``: A bus as a listener hears it: its monitor, and of each slave the last octets and bring-ups, for reports
  and stories
- ``inventory``: I&M0 of the DP-V1 slaves of a bus that runs, read once from each beside data exchange
- ``listening``: The transmissions of a line, from an own port or from the tap of a running program
- ``names``: Names and texts for explained telegrams: of a configuration, of GSD files, of drives
- ``own_tap``: The transmissions of the bus that this program itself runs, for the report of ``dpstack run``
- ``plant_files``: Files that a monitor needs: devices from a configuration and from a folder of GSD files, thresholds
  from TOML
- ``program_tap``: The transmissions of a line that a running program of ours holds, from its control socket
- ``report_file``: The file of an acceptance report, and the report of a running bus
- ``tap_cutter``: The entries of a tap, cut into transmissions
- ``telegram_table``: The telegrams of a capture as Parquet files: a row a telegram, a file for each hour
"""
