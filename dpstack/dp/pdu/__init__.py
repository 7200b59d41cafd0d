"""The octets of DP-V0: requests, diagnosis, and what they mean.

- ``alarm_blocks``: The blocks of alarms and status messages in the diagnosis of a DP-V1 slave
- ``diag_bits``: Every bit of the diagnosis in one table: who sets it, what the master does about it
- ``diag_blocks``: The blocks of the extended diagnosis, read and made: device, identifier, channel related, revision
- ``diag_texts``: The blocks of an extended diagnosis in words: the standard's, and those of the device's GSD file
- ``diagnosis``: The diagnosis of a slave: the six fixed octets, and the blocks that may follow
- ``dpv1_status``: What Set_Prm says to a DP-V1 slave: DPV1_Status_1 to 3, and structured parameter blocks
- ``layouts``: The octets of the DP services, declared once with construct behind a typed wrapper
- ``prm_blocks``: Structured parameters of Set_Prm (Prm_Structure in DPV1_Status_3): blocks
- ``requests``: The request PDUs of DP-V0: Set_Prm, Global_Control and Set_Slave_Add
"""
