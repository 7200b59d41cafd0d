"""FDL services for programs: requests with their confirmations, and service access points (SAPs) of one's own.

- ``confirmations``: The services of FDL and the table of their confirmations (L_status)
- ``identity``: The answers of Request Ident and Request LSAP Status: octets and values
- ``orders``: Orders of a program to the FDL services of an active station, and the events that answer them
- ``requester``: The user of the link layer that sends the requests of a program: a bounded queue
- ``saps``: The service access points of an active station: answers to other masters, indications, reply buffers
"""
