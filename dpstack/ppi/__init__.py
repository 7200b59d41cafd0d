"""S7-200 over PPI: addresses and PDUs of the CPU. Pure; the telegrams are SRD services of :mod:`dpstack.fdl`.

- ``addresses``: Addresses as STEP 7-Micro/WIN writes them: ``VW100``, ``M0.3``, ``AIW4``, ``T37``
- ``cpu``: A simulated CPU: memory areas, mode and clock behind the same PDUs
- ``pdu``: Requests and answers of the CPU: read, write, run, stop, clock, and its errors in words
"""
