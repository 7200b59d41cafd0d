"""Talking to running programs: a Unix socket with JSON lines beside every ``run``, ``sim`` and ``segment``.

A request is ``{"command": "trip", "args": ["3", "F2100"]}``. With ``"until_ns"`` (CLOCK_MONOTONIC) it has a limit: a
program that reads it later (it was stopped, or busy) drops it. Its answer is ``{"ok": true, "result": ...}`` or
``{"ok": false, "error": "...", "usage": true}`` (``usage``: the request was wrong, not the world; what failed at a
drive has ``kind`` and ``drive``, too). A command that goes on sends any number of ``{"item": ...}`` before that.
Requests of one connection are answered one after the other.

- ``answers``: Answers of the control socket: the fields that every program's answers have, and the check of fields
- ``arguments``: Parsers of command arguments: times, numbers, switches, octets
- ``client``: The client's end of the control socket: finds a running program by its port and sends commands
- ``commands``: Tables of the commands that running programs accept over the control socket, for each kind of program
- ``drive_check``: Check of orders for a drive before the first of them goes out: numbers, ranges, names and steps of
  parameters
- ``drive_commands``: Commands for a drive (``speed``, ``stop``, ``read`` ...): parser of their arguments, execution,
  answers in JSON
- ``errors``: Errors over the control socket: an error in the program raises the same error in its client
- ``handlers``: The control servers of run, sim and segment, with a handler for each command
- ``handlers_slaves``: Commands on simulated slaves: of a ``sim``, and of a ``run`` whose slaves are simulated in it
- ``own_master``: A master for one drive of a configuration: the others are left alone; on leaving, the drive is
  stopped in order
- ``record_commands``: Commands for the records of a slave (``read``, ``write`` ...), of ``dpstack acyclic`` and the
  control socket
- ``remote_drive``: A drive of another program: commands to the ``run`` that holds the port, over its control socket;
  and its server
- ``remote_records``: Records of a slave of another program: commands to the ``run`` that holds the port, over its
  control socket
- ``server``: The server's end of the control socket of a run, sim or segment
- ``socket_path``: Control sockets as files: names, directory, and the user at the other end of a connection
"""
