"""Configurations: a TOML file or a dict, checked key by key."""
