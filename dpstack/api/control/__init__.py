"""Talking to running programs: a Unix socket with JSON lines beside every ``run``, ``sim`` and ``segment``.

A request is ``{"command": "trip", "args": ["3", "F2100"]}``. With ``"until_ns"`` (CLOCK_MONOTONIC) it has a limit: a
program that reads it later (it was stopped, or busy) drops it. Its answer is ``{"ok": true, "result": ...}`` or
``{"ok": false, "error": "...", "usage": true}`` (``usage``: the request was wrong, not the world; what failed at a
drive has ``kind`` and ``drive``, too). A command that goes on sends any number of ``{"item": ...}`` before that.
Requests of one connection are answered one after the other.
"""
