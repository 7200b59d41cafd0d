"""Loaded by a bus process whose PYTHONPATH has this folder: switches off the settings that BENCH_WITHOUT names."""

from __future__ import annotations

import os
import sys

if "dpstack.drivers.process" in sys.orig_argv and os.environ.get("BENCH_WITHOUT"):
    from bench.settings import switch_off

    switch_off(os.environ["BENCH_WITHOUT"].split(","))
