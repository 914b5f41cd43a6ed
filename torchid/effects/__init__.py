"""The catalogue of effects: each one plants itself in a recording and predicts what it does there."""
