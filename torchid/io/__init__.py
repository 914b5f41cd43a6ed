"""torchid."""
