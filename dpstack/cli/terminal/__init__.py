"""Terminal of the commands: output, reports, signals.

- ``causes``: Likely causes of slaves that are not in data exchange, in the output of ``dpstack run``
- ``drawing``: Lines, tables and bars of progress as rich draws them on a terminal
- ``live_screen``: The live screen of ``dpstack run``: when there is one, its orders, lines that wait for its end
- ``nonblocking_stdout``: Standard streams that never block the program: a thread writes the queued output
- ``output``: Words, tables, JSON lines, warnings; standard streams that are closed, lost or full
- ``questions``: Questions on standard error, with answers from standard input
- ``report``: Reports of a running bus: events as JSON lines or lines for people, and the summary at the end
- ``signals``: Signals that end a command: SIGINT, SIGTERM, SIGHUP; and the loss of standard output
- ``suspension``: Ctrl-Z and ``fg``: the bus goes to Clear with safe values before the program is stopped
"""
