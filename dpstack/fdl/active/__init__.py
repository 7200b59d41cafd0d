"""The active station: token, exchange, ring.

- ``context``: What the handlers of an active station share: its state, what it is about to send, its deadline
- ``cycle_window``: What may still be started before the next cycle
- ``exchange``: One exchange with a station: the request, its answer or the lack of it, repetitions, late answers
- ``fcb``: Requester side of the frame count bit: FCB and FCV of the next request, per responder
- ``las_gap``: Book-keeping of the token ring as plain data: LAS, GAP, how much bus time silent polls may take
- ``listen_idle_claim``: Handlers of the states without the token: Offline, Listen_Token, Active_Idle, and Claim_Token
- ``pass_token``: Handlers of Pass_Token and Check_Token_Pass
- ``request_filter``: A guard between the link layer and its users: what it refuses never becomes a telegram
- ``states``: The state machine of an active station as data: states, inputs
- ``station``: The active station: a master's link layer with the whole token ring
- ``use_token``: Handlers of a token hold: Use_Token, Check_Access_Time, the GAP poll
"""
