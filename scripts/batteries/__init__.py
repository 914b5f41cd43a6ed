"""Sessions made without a line of torchid, and effects hidden in them."""
