"""DP: service PDUs, process image, master, slave application, rotation plan.

- ``acyclic/``: The acyclic services of the master: the queue, its jobs, and class 2
- ``master/``: The DP master: its mode, its cycle, and one slave handler a slave
- ``pdu/``: The octets of DP-V0: requests, diagnosis, and what they mean
- ``plan/``: The plan of a bus: rotation time, cycle, T_TR, before anything is sent
- ``slave/``: The DP slave: its states, its services, and what an author of a device writes
- ``error_origin``: Where in a device's own functions an exception comes from
- ``process_data``: Names for process data: what the octets of a slave's inputs or outputs mean
- ``process_image``: The process image: the inputs and outputs of a slave, which the bus exchanges in every rotation
- ``rate_groups``: Rate groups: in which cycles a slave of ``every`` n has its turn
- ``services``: The services of MS0 at a slave: their names and SAPs, the requests of a master
- ``slave_params``: What a master must know of a slave before it can bring it up, checked at construction
- ``telegram_times``: How long telegrams and exchanges take on the wire, in octets and bit times
"""
