"""The causes why a slave is not in data exchange: evidence in, a story out. Pure; nothing here asks a bus.

- ``causes``: The fixed list of causes, each with its meaning, its evidence, and the next step
- ``evidence``: Evidence about one slave: plain frozen data, from a running master, a class 2 look at the bus, or a
  listener
- ``facts``: Facts drawn from the evidence of one slave, each computed once
- ``judge``: Causes of a slave that is not in data exchange, each with what speaks for and against it
- ``steps``: Steps of a bring-up in words: the request, the answer, and the octet that refuses
- ``story``: The story of one slave: its last bring-up in words, and the causes in order
"""
