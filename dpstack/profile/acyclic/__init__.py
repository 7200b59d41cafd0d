"""PROFIdrive's parameter channel over DP-V1, record 47: both ends as pure machines.

``record47``: the octets; ``formats``: of values; ``client``: asks, splits, waits; ``lists``: what a drive
tells of itself; ``access``, ``choice``: for drive plugins; ``server``, ``model``: the drive's end; ``services``: what
carries them.
"""
