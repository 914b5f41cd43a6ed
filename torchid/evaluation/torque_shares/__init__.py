"""What the human and what a device supply at every joint, and how sure that is."""
