"""The acyclic services of the master: the queue, its jobs, and class 2.

- ``class2``: A class 2 master: Slave_Diag, Get_Cfg, RD_Inp, RD_Outp, Set_Slave_Add
- ``clock_master``: The class 3 master, and other ones: the time of this computer by Time_Event and Clock_Value (DP-V2)
- ``job``: Jobs of the acyclic queue: a service as a sequence of requests with one end
- ``queue``: The queue of acyclic services: class 2, records of DP-V1 (MS1) and class 2 connections (MS2)
"""
