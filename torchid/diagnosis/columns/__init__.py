"""This folder computes what each candidate would do to plates and markers."""
