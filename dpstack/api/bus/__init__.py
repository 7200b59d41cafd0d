"""A bus as its user sees it: made from a configuration, opened, planned, watched, closed."""
