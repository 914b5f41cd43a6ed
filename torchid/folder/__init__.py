"""From a folder of recordings to the config of a run: what is there, whom it shows, what each trial serves for."""
