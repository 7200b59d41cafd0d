"""Orders to running programs: a Unix socket with JSON lines beside every ``run``, ``sim`` and ``segment``.

A request is ``{"command": "trip", "args": ["3", "F2100"]}``. ``"until_ns"`` (CLOCK_MONOTONIC) is its time limit: a
program that reads it later (it was stopped, or busy) drops it. The answer is ``{"ok": true, "result": ...}`` or
``{"ok": false, "error": "...", "usage": true}`` (``usage``: the request itself was wrong; an error at a drive also has
``kind`` and ``drive``). Before the answer a long command sends any number of ``{"item": ...}``. The program answers
the requests of one connection one after the other.

- ``answers``: The fields of answers, by which a client checks them
- ``arguments``: Parsers of command arguments: times, numbers, switches, octets
- ``client``: The client's end of the control socket: finds a running program by its port and sends commands
- ``commands``: Tables of the commands that running programs accept; ``Order``: a parsed command
- ``control_server``: The server's end of the control socket of a run, sim or segment
- ``drive_orders``: Orders to a drive (``speed``, ``stop``, ``read`` ...): words, parser, execution, answers in JSON
- ``errors``: Errors over the control socket: an error in the program raises the same error in its client
- ``handlers``: The control server of a run, and the handlers of its commands
- ``known_stations``: The stations of a running bus as its master knows them already: live list and readings without a
  telegram
- ``live_items``: The command ``live`` of a running master: its live stream for a client of the control socket
- ``orders``: Typed orders to a running bus: carried out, or refused if they are from outside and reach no slave now
- ``record_orders``: Orders to the records of a slave (``read``, ``write`` ...): words, parser, execution, answers
- ``remote``: Orders to the ``run`` that holds the port: to a drive, or to the records of a slave
- ``round_traces``: The command ``rounds`` of a running master: values of each round for the oscilloscope of a page
- ``scenario``: Scenarios: a TOML file of steps in time that happen to simulated slaves
- ``simulation_handlers``: The control servers of sim and segment, and the commands to simulated slaves
- ``socket_path``: Control sockets as files: names, directory, owner of the peer process
- ``stream``: The lines of a long command from a running program, without blocking the event loop
- ``tap_feed``: The octets on the line of a running program, for the clients of its control socket
"""
