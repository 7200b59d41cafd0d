"""dpstack as a service of a Linux computer.

- ``notify``: The state of a running bus for the service manager (systemd), by the protocol of sd_notify
"""
