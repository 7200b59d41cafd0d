"""Prometheus metrics of a bus, and its health for probes: ``/metrics``, ``/healthz`` and ``/readyz`` over HTTP.

docs/reference/metrics.md has the table of all metrics.

- ``collector``: The metrics of this moment, from the tree of the plant
- ``connector``: The connector of the table ``[metrics]``
- ``health``: ``/healthz`` and ``/readyz``: whether the stream comes, and whether the plant is in data exchange
- ``http_server``: A small HTTP server for texts, with limits for everything
- ``processes``: CPU time, memory and file descriptors of a process of this computer
- ``table``: All metrics: name, kind, labels, meaning
"""
