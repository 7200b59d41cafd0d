"""What commands share of the terminal: output, reports, signals."""
