"""What could be hidden, where, and when."""
