"""UART timing: silence and idle times on the line, patience with late ports, noise, the UART model.

- ``line``: Silence on the line as one station knows it, and the idle times after which it may send
- ``marked``: Octets of a port that marks damaged ones: a parity or framing error, at its place
- ``neighbours``: The T_SL and T_TO that other masters need beside a port that delivers late
- ``noise``: Noise on a wire: random bit errors, with a seed so that a run can be repeated
- ``patience``: Patience: the slack added to a deadline for octets that a port delivers late, by kind of port and
  station
- ``uart``: UART model: octets as levels on the line, and the characters that a receiver at any rate samples
"""
