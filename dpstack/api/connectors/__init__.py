"""The connectors of a running bus: made from the tables of its configuration, fed, given orders to carry out, and
ended.

- ``kinds``: The connectors by name: the module of each, and how it is made from its table
- ``outside``: Outputs and drives that connectors have ordered; safe values when their connector is lost
- ``publishing``: ``publish``: the connectors of a bus from beginning to end
"""
