"""Discovery messages by which Home Assistant makes devices and entities of a plant that is published as plain JSON.

- ``discovery``: The discovery messages that a broker keeps: those to send, those of earlier runs to take away
- ``entities``: Configurations of entities: nodes of the tree as sensors, switches and numbers; orders to drives
- ``words``: Templates of Jinja for values and orders, with names of strangers as literals; units with their classes
"""
