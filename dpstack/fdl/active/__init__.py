"""The active station: token, exchange, ring.

- ``admission``: The longest duration of a request, the time-out of its answer, and whether it may start before the
  next cycle
- ``cycle_window``: The time window between two fixed cycles: which acyclic requests the station may still start before
  the next cycle
- ``exchange``: Exchange with a station: request, answer, time-out, repetitions, late answers
- ``fcb``: Requester side of the frame count bit: FCB and FCV of the next request, per responder
- ``las_gap``: Book-keeping of the token ring: list of active stations (LAS), GAP list, reported masters
- ``listen_idle_claim``: Handlers of the states without the token: Offline, Listen_Token, Active_Idle, and Claim_Token
- ``membership``: Membership in the token ring: the LAS, whether this station is in the ring, and whose token it accepts
- ``parts``: The parts that the states of an active station share: durations, line, state machine, users of the link
  layer
- ``pass_token``: Handlers of Pass_Token and Check_Token_Pass
- ``peers``: Stations asked by this one: known and slow stations, late answers that may still come, odd answers
- ``services``: FDL services of a requester: the FC octet of each, and the match of a telegram with a request
- ``states``: The state machine of an active station as data: states, inputs
- ``station``: The active station: a master's link layer with the whole token ring
- ``use_token``: Handlers of a token hold: Use_Token, Check_Access_Time, the GAP poll, and the guard of a read-only bus
"""
