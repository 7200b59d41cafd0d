"""Telegrams explained to the bit, one by one and in their course.

- ``course``: which request a telegram answers or repeats, who holds the token, what is out of order
- ``fields``: the data unit of a telegram, field by field, under the standard's names
- ``filter``: filters over explained telegrams: a small language that is parsed, never evaluated as code
- ``source``: where transmissions to be explained come from: a pcapng file, octets as hex digits, a text file with such
  lines
- ``telegram``: a telegram explained to the bit: link layer, service, fields, and what it is in the course of the bus
- ``words``: Telegrams and wire logs in words, for people: lines of ``decode``, and the log that a failing test prints
"""
