"""The octets of DP-V1.

- ``alarms``: The PDUs of alarms: alarm and status blocks of the diagnosis, Alarm_Ack
- ``describe``: What is in telegrams of DP-V1, in words: services with slot and index, refusals, Abort and its reason
- ``dpv1_status``: What Set_Prm says to a DP-V1 slave: DPV1_Status_1 to 3, and structured parameter blocks
- ``error_codes``: What a negative response says: Error_Decode, class and code with their texts
- ``im``: Identification and maintenance: I&M0 to I&M4 by the call function of index 255
- ``layouts``: The octets of the DP-V1 services, declared as those of DP-V0 are (:mod:`dpstack.dp.pdu.layouts`)
- ``ms2``: The PDUs that MS2 has beside Read and Write: Resource_Manager, Initiate, Data_Transport, Idle, Abort
- ``prm_blocks``: Structured parameters of Set_Prm (Prm_Structure in DPV1_Status_3): blocks
- ``read_write``: The PDUs of Read and Write: requests, responses, negative responses
- ``redundancy``: What a redundant slave says of itself in PrmCmdAck and Red_State
"""
