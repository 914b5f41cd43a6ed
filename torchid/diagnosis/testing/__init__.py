"""What held-out motion and tests of single causes say."""
