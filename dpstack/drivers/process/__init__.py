"""A bus in a process of its own, and its application at the other end of a socket."""
