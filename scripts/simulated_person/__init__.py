"""A simulated person who stands, does what a page advises, and is measured in real time."""
