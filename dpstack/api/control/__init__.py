"""Talking to running programs: a Unix socket with JSON lines beside every ``run``, ``sim`` and ``segment``.

A request is ``{"command": "trip", "args": ["3", "F2100"]}``. With ``"until_ns"`` (CLOCK_MONOTONIC) it has a limit: a
program that reads it later (it was stopped, or busy) drops it. Its answer is ``{"ok": true, "result": ...}`` or
``{"ok": false, "error": "...", "usage": true}`` (``usage``: the request was wrong, not the world; what failed at a
drive has ``kind`` and ``drive``, too). A command that goes on sends any number of ``{"item": ...}`` before that.
Requests of one connection are answered one after the other.

- ``arguments``: Parsers of command arguments: times, numbers, switches, octets
- ``client``: The client's end of the control socket: finds a running program by its port and sends commands
- ``commands``: Tables of the commands that running programs accept; ``Order``: a parsed command
- ``drive_orders``: Orders to a drive (``speed``, ``stop``, ``read`` ...): words, parser, execution, answers in JSON
- ``errors``: Errors over the control socket: an error in the program raises the same error in its client
- ``handlers``: The control servers of run, sim and segment, with a handler for each command
- ``record_orders``: Orders to the records of a slave (``read``, ``write`` ...): words, parser, execution, answers
- ``remote``: Orders to the ``run`` that holds the port: to a drive, or to the records of a slave
- ``server``: The server's end of the control socket of a run, sim or segment
- ``socket_path``: Control sockets as files: names, directory, and the user at the other end of a connection
"""
