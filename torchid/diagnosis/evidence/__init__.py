"""Prior, noise, statistics and posterior: how much better a candidate explains the recordings."""
