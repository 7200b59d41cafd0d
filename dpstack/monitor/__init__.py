"""A bus judged by listening to it: counters of its stations and masters.

- ``counters``: Counters of stations, masters and the bus, from the transmissions on a line
"""
