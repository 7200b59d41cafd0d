"""The faces of a running bus: made from the tables of its configuration, fed, given orders to carry out, and ended.

- ``kinds``: The faces by name: the module of each, and how it is made from its table
- ``publishing``: ``publish``: the faces of a bus from beginning to end
"""
