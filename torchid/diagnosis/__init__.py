"""This room finds what the identified model gets wrong: which effects of the catalogue recordings support."""
