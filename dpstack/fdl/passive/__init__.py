"""Passive stations.

- ``multi_station``: Several passive stations behind one port: one decoder, one answer at a time, broadcasts to all
- ``station``: The passive station: the responder's side of the link layer
"""
