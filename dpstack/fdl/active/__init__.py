"""The active station: token, exchange, ring.

- ``admission``: How long a request can take, how long its answer is waited for, and whether it may start before the
  next cycle
- ``cycle_window``: The time window between two fixed cycles: which acyclic requests the station may still start before
  the next cycle
- ``exchange``: One exchange with a station: the request, its answer or the lack of it, repetitions, late answers
- ``fcb``: Requester side of the frame count bit: FCB and FCV of the next request, per responder
- ``las_gap``: Book-keeping of the token ring as plain data: LAS, GAP, bus time for silent polls, reported masters
- ``listen_idle_claim``: Handlers of the states without the token: Offline, Listen_Token, Active_Idle, and Claim_Token
- ``membership``: This station's place in the token ring: the LAS, whether it is in the ring, and whose token it takes
- ``parts``: The parts that the states of an active station share: durations, line, state machine, users of the link
  layer
- ``pass_token``: Handlers of Pass_Token and Check_Token_Pass
- ``peers``: The stations that this one asks: which are there, whose answers may still come, whose answers are odd
- ``services``: FDL services as the requester sees them: the FC octet of each, and which telegram answers which request
- ``states``: The state machine of an active station as data: states, inputs
- ``station``: The active station: a master's link layer with the whole token ring
- ``use_token``: Handlers of a token hold: Use_Token, Check_Access_Time, the GAP poll, and the guard of a read-only bus
"""
