"""The octets of DP-V1.

- ``error_codes``: Error_Decode, error class and error code of a negative response, with their texts
- ``im``: Identification and maintenance: I&M0 to I&M4 by the call function of index 255
- ``ms2``: The PDUs that open, keep and end a class 2 connection: Resource_Manager, Initiate, Idle, Abort
- ``read_write``: The PDUs of Read, Write, Data_Transport and Alarm_Ack: requests, responses, negative responses
"""
