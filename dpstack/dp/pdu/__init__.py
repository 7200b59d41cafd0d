"""The octets of DP-V0: requests, diagnosis, and what they mean.

- ``alarm_blocks``: The blocks of alarms and status messages in the diagnosis of a DP-V1 slave
- ``clock``: Clock synchronisation of DP-V2: Time_Event, Clock_Value, time-stamped process alarms and their records
- ``diag_bits``: The bits of the diagnosis as one table: who sets each, what the master does about it
- ``diag_blocks``: The blocks of the extended diagnosis, read and made: device, identifier, channel related, revision
- ``diag_texts``: Texts for the blocks of an extended diagnosis: the standard's, and those of the device's GSD file
- ``diagnosis``: The diagnosis of a slave: six fixed octets and the blocks after them
- ``dpv1_status``: DPV1_Status_1 to 3 in Set_Prm, and the structured parameters that follow them
- ``dxb``: Data exchange broadcast (DXB, DP-V2): filters of a subscriber, and the link status message
- ``layouts``: Layouts of PDUs, declared bit by bit with construct
- ``pa_diagnosis``: DIAGNOSIS of PROFIBUS PA: four octets of the physical block, which a device sends in its Slave_Diag
  too
- ``prm_blocks``: Structured parameters of Set_Prm (Prm_Structure in DPV1_Status_3): blocks
- ``prm_checks``: Checks of Set_Prm for DP-V2: blocks of isochronous mode (type 4), redundancy (type 2) and clock (type
  8), in words
- ``prm_contents``: What blocks of structured parameters hold, by their type
- ``redundancy``: PrmCmdAck and Red_State: status messages of a redundant slave, with the state of both of its sides
- ``requests``: The request PDUs of DP-V0: Set_Prm, Global_Control and Set_Slave_Add
"""
