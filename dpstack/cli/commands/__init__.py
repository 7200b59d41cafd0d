"""The commands of the program, a module each.

- ``acyclic``: ``dpstack acyclic``: Read and Write of DP-V1, I&M, at one slave
- ``address``: ``dpstack address``: gives a slave another station address
- ``baud``: ``dpstack baud``: finds the baud rate by listening only
- ``ctl``: ``dpstack ctl``: tells a running program what to do
- ``demo``: ``dpstack demo``: every known drive, simulated, under a master, in one process
- ``demo_stories``: What the drives of ``dpstack demo`` are put through: one short program for each
- ``doctor``: ``dpstack doctor``: is this computer fit for a bus, and what to do about it
- ``drive``: ``dpstack drive``: one drive by hand, through the run that holds the port or as master in the foreground
- ``drive_run``: The orders of ``dpstack drive``, carried out one after the other, and what is told of them
- ``gsd``: ``dpstack gsd``: what a GSD file says, what is wrong with it, and the way to a [[slave]] table
- ``gsd_configure``: ``dpstack gsd configure``: asks its way from a GSD file to a [[slave]] table
- ``lists``: Lists of parameters as people read them and as JSON: dumped and compared
- ``on_bus``: What commands share that are on a bus: one errand on it, a master's run, the control socket beside it
- ``plan``: ``dpstack plan``: what a bus will do, before it is switched on
- ``ports``: ``dpstack ports``: the serial adapters of this computer
- ``run``: ``dpstack run``: the soft master
- ``scan``: ``dpstack scan``: who is on the bus, without changing anything there
- ``segment``: ``dpstack segment``: a virtual RS-485 segment of ptys
- ``sim``: ``dpstack sim``: simulated slaves on a port
"""
