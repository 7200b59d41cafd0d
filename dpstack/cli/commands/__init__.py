"""The commands of the program ``dpstack``, one module for each.

- ``acyclic``: ``dpstack acyclic``: DP-V1 records and I&M of one slave
- ``address``: ``dpstack address``: gives a slave another station address
- ``completion``: ``dpstack completion``: the completion scripts of bash, zsh and fish
- ``ctl``: ``dpstack ctl``: gives orders to a running program
- ``demo``: ``dpstack demo``: every known drive, simulated, under one master
- ``demo_stories``: The programs that ``dpstack demo`` runs, one for each known drive
- ``doctor``: ``dpstack doctor``: checks of adapters, permissions, latency and real-time rights
- ``drive``: ``dpstack drive``: manual control of one drive, through a running master or as master in the foreground
- ``gsd``: ``dpstack gsd``: shows, checks, configures and copies GSD files
- ``gsd_configure``: ``dpstack gsd configure``: a dialogue that makes a [[slave]] table from a GSD file
- ``lists``: Output of dumps and comparisons of parameter lists, as text and JSON
- ``on_bus``: Shared parts of the commands that open a bus: port options, baud rate, control socket
- ``plan``: ``dpstack plan``: bus parameters, rotation times and watchdogs of a configuration
- ``ports``: ``dpstack ports``: the serial adapters of this computer
- ``run``: ``dpstack run``: the soft master
- ``scan``: ``dpstack scan``: the live list of a bus
- ``segment``: ``dpstack segment``: a virtual RS-485 segment of ptys
- ``sim``: ``dpstack sim``: simulated slaves on a port
"""
