"""dpstack as a service of a Linux computer.

The files of the set-up: ``setup_adapter.sh``, which installs the udev rule ``99-dpstack.rules``, real-time rights and
the systemd unit ``dpstack@.service``.

- ``host_setup``: The steps of the set-up of this computer, printed or carried out as root
- ``notify``: The state of a running bus for the service manager (systemd), by the protocol of sd_notify
"""
