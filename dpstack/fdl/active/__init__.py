"""The active station: token, exchange, ring."""
