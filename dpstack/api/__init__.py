"""What a user imports: configuration, bus, slaves, drives."""
