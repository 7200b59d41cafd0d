"""A slave and a drive of a bus as their user sees them."""
