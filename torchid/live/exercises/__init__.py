"""What a subject is asked to do next, and a simulated one who does it."""
