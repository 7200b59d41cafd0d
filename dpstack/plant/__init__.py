"""A plant as typed values, without bus and network: the orders that change it.

- ``orders``: Orders to a plant: named outputs of a slave, the operation of a drive, the mode of the master
"""
