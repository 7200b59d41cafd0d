"""DP: service PDUs, process image, master, slave application, rotation plan.

- ``acyclic/``: The acyclic services of the master: the queue, its jobs, and class 2
- ``master/``: The DP master: its mode, its cycle, and one slave handler a slave
- ``pdu/``: The octets of DP-V0: requests, diagnosis, and what they mean
- ``plan/``: The plan of a bus: rotation time, cycle, T_TR, before anything is sent
- ``slave/``: The DP slave: its states, its services, and what an author of a device writes
- ``channels``: The channels of a slave as fields with proposed names
- ``counter``: Counters that begin again at the end of their range, such as the position of an encoder, and named values
  of them
- ``doubts``: The parts of a slave's process data that its diagnosis throws doubt on: slot, channel, octets, the reason
  in words
- ``error_origin``: The origin of an exception in the functions of a device or of a drive plugin
- ``field_map``: The named fields of an image of process data as a whole, and their values
- ``process_data``: Named fields in the process data of a slave, declared as short texts
- ``process_image``: The process image: the inputs and outputs of a slave, which the bus exchanges in every rotation
- ``rate_groups``: Rate groups: in which cycles a slave of ``every`` n has its turn
- ``services``: The services of MS0 at a slave: their names and SAPs, the octets of Set_Prm, positive answers
- ``slave_params``: The parameters of one slave at the master, checked at construction; the telegrams of a drive
- ``slot_map``: The map of a slave: slot, module, direction, octets, channels; from identifier octets and, if known, its
  GSD file
- ``telegram_times``: Durations of telegrams and exchanges on the wire, in octets and bit times
"""
