"""A slave and a drive of a bus as their user sees them.

- ``alarms``: ``slave.alarms()``: alarms as an application takes and acknowledges them
- ``class2``: The services of a class 2 master, to be awaited: ``bus.class2``
- ``drive``: One drive as an application sees it: orders as awaitable calls, errors by type, the latest status
- ``host``: What a slave, a drive and the class 2 services need of the bus that they are on
- ``ms2_connection``: A class 2 connection (MS2) to a slave, to be awaited: ``bus.class2.connect(...)``
- ``record_parameters``: PROFIdrive's parameter access in an asyncio program: any number of parameters, whole lists
- ``records``: Read and Write of DP-V1 at one slave, to be awaited, by whatever way they go; I&M as typed records
- ``service_errors``: What each failure of an acyclic service is raised as, whatever the service
- ``services``: Acyclic services to be awaited: who waits for which
- ``slave``: One slave as an application sees it
"""
