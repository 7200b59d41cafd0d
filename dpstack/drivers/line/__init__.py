"""A machine on a port of this process: event loops, timers, the lateness of ports."""
