"""A bus judged by listening to it: counters of its stations and masters, and the report of it.

- ``counters``: Counters of stations, masters and the bus, from the transmissions on a line
- ``drawings``: Histograms, time line and schedule of the report as SVG
- ``report``: The acceptance report of a bus: one HTML file that a customer reads, prints and signs
- ``schedule``: The schedule of one rotation, from a bounded record
"""
