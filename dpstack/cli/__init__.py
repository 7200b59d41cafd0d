"""The program ``dpstack``: one module per command, all over the public API.

- ``commands/``: The commands of the program, a module each
- ``terminal/``: What commands share of the terminal: output, reports, signals
- ``main``: The entry point: finds the command, turns every expected error into one line and gives the exit code
- ``options``: Arguments that several commands share, and their checks
"""
