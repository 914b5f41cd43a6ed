"""What each candidate would do to plates and markers."""
