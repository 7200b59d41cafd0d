"""The DP master: its mode, its cycle, and one slave handler a slave.

- ``commands``: Orders to the DP master and its modes
- ``cycle``: One round over the slaves: which request comes next
- ``events``: Events of the DP master for the application
- ``fault_texts``: The texts of every fault of a slave: one clear line that says what happened, and what to do
- ``fixed_cycle``: When the rounds over the slaves begin: as fast as the bus allows, or on an equidistant grid
- ``global_control``: Global_Control: the master's mode, repeated; SYNC, FREEZE and their ends, each sent exactly once
- ``master``: The class 1 master: modes and the ordered end
- ``outputs_watch``: When the master goes to Clear by itself: auto-clear, the stall rule, the application watchdog
- ``plugin_host``: Calls a slave's drive plugin and catches its exceptions, so that the bus goes on
- ``poll_order``: The order of polls: the slaves with Data_Exchange in a round, and the slave with the next service
- ``retry_timing``: When the next service request to a slave is due: back-off of retries, long polls of absent slaves
- ``scanner``: The scanner: the live list, filled up with ident number, state and owner of each slave
- ``settings``: Settings of a DP master that do not depend on its slaves, and the state that all its parts share
- ``slave_handler``: The master's handling of one slave: what to ask it next, and what its answers mean
- ``slave_list``: The slaves of a master while the bus runs: added, removed, taken out of service, parameterised anew
- ``slave_reports``: Reports of one slave to the application: faults, remarks, diagnoses; alarms for their observer
- ``slave_states``: The master's handling of one slave as a table: (state, what happened) -> state, with the clause
- ``verdicts``: What answers mean to a master that did not write the slave: diagnoses and odd answers to Data_Exchange
"""
