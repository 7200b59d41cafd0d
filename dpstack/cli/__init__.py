"""The program ``dpstack``: one module per command, all over the public API."""
