"""The DP master: its mode, its cycle, and one slave handler a slave.

- ``bring_ups``: Record of the last bring-ups of one slave: each request besides the cycle with its answer; the losses
- ``commands``: Orders to the DP master and its modes
- ``cycle``: One round over the slaves and the order of its requests
- ``events``: Events of the DP master for the application
- ``fault_texts``: The texts of all faults of a slave, one function a fault: what happened, and what to do
- ``fixed_cycle``: Start times of the rounds over the slaves: as fast as the bus allows, or on an equidistant grid
- ``global_control``: Global_Control: the master's mode, repeated; SYNC, FREEZE and their ends, each sent exactly once
- ``master``: The class 1 master: modes and the ordered end
- ``outputs_watch``: Reasons for Clear without an order: auto-clear, the stall rule, the application watchdog
- ``plugin_host``: Calls a slave's drive plugin and catches its exceptions, so that the bus goes on
- ``poll_order``: The order of polls: the slaves with Data_Exchange in a round, and the slave with the next service
- ``retry_timing``: Due times of service requests to a slave: back-off of retries, long polls of absent slaves
- ``scanner``: The scanner: the live list with ident number, state and owner of each slave
- ``settings``: Settings of a DP master that do not depend on its slaves, and the state that all its parts share
- ``slave_handler``: The master's handling of one slave: its next request, and the meaning of its answers
- ``slave_list``: The slaves of a master while the bus runs: added, removed, taken out of service, parameterised anew
- ``slave_reports``: Reports of one slave to the application: faults, remarks, diagnoses; alarms for their observer
- ``slave_states``: The master's handling of one slave as a table: (state, what happened) -> state, with the clause
- ``verdicts``: Judgement of diagnoses and of answers to Data_Exchange without good data
"""
