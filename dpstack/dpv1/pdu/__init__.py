"""The octets of DP-V1.

- ``error_codes``: What a negative response says: Error_Decode, class and code with their texts
- ``im``: Identification and maintenance: I&M0 to I&M4 by the call function of index 255
- ``layouts``: The octets of the DP-V1 services, declared as those of DP-V0 are (:mod:`dpstack.dp.pdu.layouts`)
- ``ms2``: The PDUs that MS2 has beside Read and Write: Resource_Manager, Initiate, Data_Transport, Idle, Abort
- ``read_write``: The PDUs of Read and Write: requests, responses, negative responses
"""
