"""What makes a bus process punctual: rights, its share of the processor, the collector."""
