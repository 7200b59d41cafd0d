"""Masters of others beside dpstack: ``table`` measures them, ``profirust`` is the program around profirust (Rust)."""
