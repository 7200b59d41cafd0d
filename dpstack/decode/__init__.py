"""Telegrams explained to the bit, one by one and in their course.

- ``course``: which request a telegram answers or repeats, who holds the token, what is out of order
- ``fields``: the data unit of a telegram, field by field, under the standard's names
- ``filter``: filters over explained telegrams: a small language that is parsed, never evaluated as code
- ``names``: names and texts of stations: of a user's configuration, or of a GSD file
- ``source``: where transmissions to be explained come from: a pcapng file, octets as hex digits, a text file with such
  lines
- ``stations``: the stations of a bus as their own telegrams describe them; fields with their names
- ``telegram``: a telegram explained to the bit: link layer, service, fields, and what it is in the course of the bus
- ``wire_log``: wire logs in words: the log that a failing test and the referee of a simulated bus print
- ``words``: telegrams in words, one line each, made of the fields
"""
