"""The goals of reliability, measured or taken from the last record."""
