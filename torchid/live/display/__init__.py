"""The page of a stream."""
