"""The program ``dpstack``: its commands, options and terminal output.

- ``assistants/``: Read-only tools for assistants: ``dpstack mcp``
- ``commands/``: The commands of the program, one module for each
- ``devices/``: The commands about kinds of drives and devices, and the files that describe them
- ``link/``: Commands below DP: services of the link layer
- ``listening/``: The commands that only listen, or explain what was heard
- ``looking/``: The commands that look at a plant: on a page, on the screen, in words
- ``terminal/``: Output, reports and signals
- ``main``: Entry point: command line, error output, exit codes
- ``options``: Options and argument types that several commands share
- ``parser``: ``Parser``: command lines, their errors and help
"""
