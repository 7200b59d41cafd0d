"""What keeps a machine running: an asyncio loop on a port, or the virtual world."""
