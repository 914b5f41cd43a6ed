"""What every command here does alike: options, seeds, processes, rows that are kept, whole runs, figures."""
