"""Work on single trials: first posture, wrapped angles, jumps, gaps."""
