"""The acyclic services of the master: the queue, its jobs, and class 2.

- ``class2``: A class 2 master: Slave_Diag, Get_Cfg, RD_Inp, RD_Outp, Set_Slave_Add
- ``job``: Jobs of the acyclic queue: a service as a sequence of requests with one end
- ``queue``: Everything a station asks slaves beside the cycle: services of a class 2 master, DP-V1
"""
