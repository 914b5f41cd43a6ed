"""Many subjects, each run as by itself in a process of its own, with one table and one page of all."""
