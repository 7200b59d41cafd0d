"""The acyclic services of the master: who may ask what next, and class 2.

- ``class2``: A class 2 master: Slave_Diag, Get_Cfg, RD_Inp, RD_Outp, Set_Slave_Add
- ``job``: What everything acyclic is to the queue (:mod:`dpstack.dp.acyclic.queue`): a job with one end
- ``queue``: Everything a station asks slaves beside the cycle: services of a class 2 master, DP-V1
"""
