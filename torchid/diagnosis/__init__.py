"""What the identified model gets wrong: which effects of the catalogue recordings support, and which not."""
