"""What commands share of the terminal: output, reports, signals.

- ``drawing``: Lines, tables and bars of progress as rich draws them on a terminal
- ``lost_stdout``: Standard output and standard error as they really are: closed from the start, lost in the middle
- ``nonblocking_stdout``: Standard streams that never hold the program up
- ``output``: Words, tables and JSON lines: drawn on a terminal, plain lines elsewhere
- ``report``: What a running bus tells: JSON lines, or lines for people; the summary at the end
- ``signals``: SIGINT, SIGTERM and SIGHUP, and output that nobody takes: the ways in which a command is told to end
"""
